"""/v1/target_tasks: what a robot's client asks over HTTP."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace

import pytest
from pydantic import ValidationError

from api.routes.target_tasks import Claim, task_view
from api.routes.target_tasks import claim as claim_route
from db import runs, visits
from tests.db.leases import SPEC, claim, publish


def test_a_claim_whose_client_has_gone_is_given_back(database):
    id = publish(database, runs.create_run(database, SPEC).id)
    service = SimpleNamespace(
        database=database, claim=lambda worker, tasks: claim(database, worker, tasks=tasks)
    )
    gone = SimpleNamespace(is_disconnected=coroutine(False, True))  # it goes meanwhile
    asked = Claim(worker="a", tasks=["arm"], wait_s=20.0)
    answer = asyncio.run(claim_route(asked, service, gone))
    assert answer.status_code == 204
    assert visits.get_visit(database, id).state == "pending"
    there = SimpleNamespace(is_disconnected=coroutine(False))
    assert asyncio.run(claim_route(asked, service, there)).task.id == id


def test_a_visit_of_a_task_that_is_not_installed_any_more_is_shown(database):
    """One of them had broken every list of visits."""
    visit = visits.get_visit(database, publish(database, runs.create_run(database, SPEC).id))
    assert task_view(replace(visit, task="gone")).transitions == visit.inputs["transitions"]
    unknown = replace(visit, task="gone", inputs={"seed": 0})
    assert task_view(unknown).transitions is None


def test_a_claim_of_an_unknown_task_is_refused_with_the_nearest_name():
    with pytest.raises(ValidationError, match=r"tasks\.1\n.*'hoper'; did you mean 'hopper'"):
        Claim(worker="mine", tasks=["arm", "hoper"])


def coroutine(*answers):
    """Answers so, one after the other, and then as the last time."""
    left = list(answers)

    async def ask():
        return left.pop(0) if len(left) > 1 else left[0]

    return ask

"""/v1/target_tasks: what a robot's client asks over HTTP."""

import asyncio
import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from pydantic import ValidationError

from api.routes import target_tasks
from api.routes.target_tasks import Claim, task_view
from api.routes.target_tasks import claim as claim_route
from db import runs, visits
from tests.api.standins import Service
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


@pytest.mark.parametrize(
    ("lease", "status"), [("another", 409), (None, 422), ("the robot's", 200)], ids=str
)
def test_the_body_of_a_trajectory_is_received_only_by_a_good_lease(file_database, lease, status):
    """Each one of 64 MB, whoever sent it, had been read into memory first."""
    publish(file_database, runs.create_run(file_database, SPEC).id)
    task, service, received, sent = claim(file_database, "a"), Service(file_database), [], []
    service.orchestrator.complete_task = lambda id, lease, content: visits.get_visit(
        file_database, id
    )

    async def receive():
        received.append(1)
        return {"type": "http.request", "body": b"an npz"}

    async def send(message):
        sent.append(message)

    headers = {"content-type": "application/octet-stream"}
    if lease is not None:
        headers["lease"] = task.lease if lease == "the robot's" else lease
    scope = {
        "type": "http",
        "method": "PUT",
        "path": f"/v1/target_tasks/{task.id}/trajectory",
        "query_string": b"",
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }
    asyncio.run(service.client(target_tasks.router).app(scope, receive, send))
    assert (sent[0]["status"], bool(received)) == (status, status == 200)
    if lease is None:
        assert [each["pointer"] for each in json.loads(sent[1]["body"])["errors"]] == [
            "/header/lease"
        ]


def coroutine(*answers):
    """Answers so, one after the other, and then as the last time."""
    left = list(answers)

    async def ask():
        return left.pop(0) if len(left) > 1 else left[0]

    return ask

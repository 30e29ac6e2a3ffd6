"""Single runs over HTTP."""

import asyncio

import pytest

from adr_service.specs import RunSpec
from api.routes.runs import get_run
from db import runs
from tests.api.smoke import SMOKE
from tests.api.standins import Service
from tests.db.finished import proceed
from tests.db.rows import statements
from tests.service import wait_until_finished

ray = pytest.mark.ray


@ray
def test_a_submission_is_accepted_with_the_location_of_the_run(http):
    response = http.post("/v1/runs", json={**SMOKE, "method": "prior"})
    assert response.status_code == 202
    assert http.get(response.headers["Location"]).json()["id"] == response.json()["id"]


@ray
def test_runs_are_listed_by_filter_and_page(service, http, finished):
    every = service.client.list_all("runs", page_size="1")
    assert finished in {run["id"] for run in every}
    found = http.get("/v1/runs", params={"method": "simopt", "state": "succeeded"}).json()
    assert {run["spec"]["method"]["name"] for run in found["items"]} == {"simopt"}


@ray
def test_a_dry_run_returns_the_cost_and_starts_nothing(service, http):
    before = len(service.client.list_all("runs"))
    answer = http.post("/v1/runs?validate_only=true", json={**SMOKE, "seed": 904})
    assert answer.status_code == 200
    body = answer.json()
    assert body["plan"]["trainings"] == 2
    assert body["plan"]["cores"] == 2
    assert body["spec"]["training"]["max_steps"] == 600
    assert len(service.client.list_all("runs")) == before


@ray
def test_the_same_key_makes_one_run(http):
    key, body = {"Idempotency-Key": "once"}, {**SMOKE, "method": "prior", "seed": 77}
    first, again = (http.post("/v1/runs", json=body, headers=key) for _ in range(2))
    assert (first.status_code, again.status_code) == (202, 202)
    assert first.json()["id"] == again.json()["id"]
    other = http.post("/v1/runs", json={**body, "seed": 78}, headers=key)
    assert other.status_code == 422
    assert "came with another request before" in other.json()["detail"]


@ray
def test_a_run_is_cancelled_resumed_and_deleted(service, http):
    long = {**SMOKE, "seed": 77, "training": {"max_steps": 20_000, "evaluate_every": 20_000}}
    id = service.client.submit_run(long)["id"]
    assert http.delete(f"/v1/runs/{id}").status_code == 409
    service.client.cancel(id)
    assert wait_until_finished(service.client, id, 60)["state"] == "cancelled"
    assert http.post(f"/v1/runs/{id}/resume").status_code == 202
    assert service.client.get(id)["submission"] == 2
    assert http.post(f"/v1/runs/{id}/resume").status_code == 409
    service.client.cancel(id)
    wait_until_finished(service.client, id, 60)
    assert http.delete(f"/v1/runs/{id}").status_code == 204
    assert http.get(f"/v1/runs/{id}").status_code == 404


def looks_at_runs(sent):
    """The number of times that a run was read."""
    return sum(statement.startswith("SELECT runs.") for statement in sent)


@pytest.mark.parametrize(("most", "state"), [(None, "running"), (0, "cancelled")])
def test_a_request_that_waits_is_answered_once_the_state_changes(file_database, most, state):
    run = runs.create_run(file_database, RunSpec.model_validate(SMOKE))

    async def waited(sent):
        request = asyncio.create_task(get_run(run.id, Service(file_database), wait=20.0))
        while looks_at_runs(sent) < 3:
            assert not request.done()
            await asyncio.sleep(0)
        if most is None:
            runs.begin(file_database, run)
        else:
            proceed(file_database, run, most)
        sent.clear()
        return await request

    with statements() as sent:
        assert asyncio.run(waited(sent)).state == state
    assert looks_at_runs(sent) <= 2  # one of them may have begun before the change


def test_a_request_that_waits_for_no_change_is_answered_with_the_same_state(file_database):
    run = runs.create_run(file_database, RunSpec.model_validate(SMOKE))
    with statements() as sent:
        view = asyncio.run(get_run(run.id, Service(file_database), wait=0.3))
    assert view.state == "queued"
    assert looks_at_runs(sent) == 3  # at once, after 0.25 s, and when the time was over


def test_nobody_waits_for_a_run_that_has_ended(file_database):
    run = runs.create_run(file_database, RunSpec.model_validate(SMOKE))
    proceed(file_database, run, most=0)
    with statements() as sent:
        assert asyncio.run(get_run(run.id, Service(file_database), wait=20.0)).state == "cancelled"
    assert looks_at_runs(sent) == 1

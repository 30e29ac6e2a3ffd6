"""Single runs over HTTP."""

import pytest

from tests.api.smoke import SMOKE
from tests.service import wait_until_finished

pytestmark = pytest.mark.ray


def test_a_submission_is_accepted_with_the_location_of_the_run(http):
    response = http.post("/v1/runs", json={**SMOKE, "method": "prior"})
    assert response.status_code == 202
    assert http.get(response.headers["Location"]).json()["id"] == response.json()["id"]


def test_runs_are_listed_by_filter_and_page(service, http, finished):
    every = service.client.list_all("runs", page_size="1")
    assert finished in {run["id"] for run in every}
    found = http.get("/v1/runs", params={"method": "simopt", "state": "succeeded"}).json()
    assert {run["spec"]["method"]["name"] for run in found["items"]} == {"simopt"}


def test_a_dry_run_returns_the_cost_and_starts_nothing(service, http):
    before = len(service.client.list_all("runs"))
    answer = http.post("/v1/runs?validate_only=true", json={**SMOKE, "seed": 904})
    assert answer.status_code == 200
    body = answer.json()
    assert body["plan"]["trainings"] == 2
    assert body["plan"]["cores"] == 2
    assert body["spec"]["training"]["max_steps"] == 600
    assert len(service.client.list_all("runs")) == before


def test_the_same_key_makes_one_run(http):
    key, body = {"Idempotency-Key": "once"}, {**SMOKE, "method": "prior", "seed": 77}
    first, again = (http.post("/v1/runs", json=body, headers=key) for _ in range(2))
    assert (first.status_code, again.status_code) == (202, 202)
    assert first.json()["id"] == again.json()["id"]
    other = http.post("/v1/runs", json={**body, "seed": 78}, headers=key)
    assert other.status_code == 422
    assert "came with another request before" in other.json()["detail"]


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

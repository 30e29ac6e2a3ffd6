"""Grids of runs over HTTP."""

import pytest

from adr_service.client import Refused
from tests.service import wait_until_finished

pytestmark = pytest.mark.ray


def test_extending_a_finished_benchmark_computes_nothing_twice(service):
    spec = {"tasks": ["arm"], "methods": ["droid"], "seeds": [0], "preset": "smoke"}
    id = service.client.submit_benchmark(spec)["id"]
    wait_until_finished(service.client, id, 120)
    before = service.client.results(id)["rows"]
    started = service.started_stages
    service.client.extend_benchmark(id, {"methods": ["udr"]})
    assert wait_until_finished(service.client, id, 120)["states"] == {"succeeded": 4}
    after = service.client.results(id)["rows"]
    assert [row for row in after if row["method"] != "udr"] == before
    new = service.started_stages[len(started) :]
    assert len(new) == 4  # two trainings, two evaluations
    assert not set(new) & set(started)
    with pytest.raises(Refused, match="has the seeds 0 already"):
        service.client.extend_benchmark(id, {"seeds": [0]})
    with pytest.raises(Refused, match="nothing to add"):
        service.client.extend_benchmark(id, {})


def test_a_benchmark_is_cancelled_and_deleted(service, http):
    spec = {"tasks": ["arm"], "methods": ["udr"], "seeds": [5, 6], "preset": "smoke"}
    training = {"max_steps": 50_000, "evaluate_every": 50_000}
    id = service.client.submit_benchmark({**spec, "training": training})["id"]
    assert http.delete(f"/v1/benchmarks/{id}").status_code == 409
    service.client.cancel(id)
    assert wait_until_finished(service.client, id, 60)["states"] == {"cancelled": 6}
    service.client.cancel(id)
    service.client.delete(id)
    assert http.get(f"/v1/benchmarks/{id}").status_code == 404


def test_a_dry_run_counts_shared_trainings_once(http):
    spec = {"tasks": ["arm"], "methods": ["udr", "simopt", "dropo"], "seeds": [90_001, 90_002]}
    body = http.post("/v1/benchmarks?validate_only=true", json={**spec, "preset": "smoke"})
    # These seeds are this test's alone: what another test has trained counts as nothing here.
    # Per seed: prior, oracle, 2 of UDR, 1 of SimOpt, 1 of DROPO.
    assert body.json()["plan"]["trainings"] == 12

"""The service keeps its runs in PostgreSQL."""

import httpx2
import pytest

from tests.service import start_service, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]  # tests/db/test_postgresql.py is fast
BENCHMARK = {
    "tasks": ["arm"],
    "methods": ["droid"],
    "collectors": ["random"],
    "seeds": [0],
    "preset": "smoke",
    "references": False,
}


def test_a_service_keeps_its_runs_in_postgresql(postgresql, tmp_path):
    environment = {"ADR_DATABASE_URL": postgresql.new_database()}
    with start_service(tmp_path, cpus=1, environment=environment) as running:
        client = running.client
        id = client.submit_benchmark(BENCHMARK)["id"]
        client.cancel(id)
        assert wait_until_finished(client, id, 60)["states"] == {"cancelled": 1}
        client.resume(id)
        client.extend_benchmark(id, {"seeds": [1]})
        assert wait_until_finished(client, id, 120)["states"] == {"succeeded": 2}
        pages = ["/", f"/benchmarks/{id}", f"/v1/benchmarks/{id}/results", "/v1/claims", "/metrics"]
        (run, _) = client.get(id)["runs"]
        for path in [*pages, f"/runs/{run['id']}", "/v1/benchmarks", "/v1/runs?task=arm"]:
            assert httpx2.get(client.url + path, timeout=60).status_code == 200, path
    assert not (tmp_path / "adr.sqlite").exists()

"""A client of the tests' service, and runs on it that many tests read."""

import httpx2
import pytest

from tests.api.smoke import SMOKE
from tests.service import RunningService, wait_until_finished


@pytest.fixture(scope="session")
def http(service: RunningService):
    with httpx2.Client(base_url=service.client.url, timeout=60) as client:
        yield client


@pytest.fixture(scope="session")
def finished(service: RunningService):
    """Id of a SimOpt run that has succeeded."""
    run = service.client.submit_run(SMOKE)
    assert wait_until_finished(service.client, run["id"], 120)["state"] == "succeeded"
    return run["id"]


@pytest.fixture(scope="session")
def benchmark(service: RunningService):
    """Id of a benchmark that has succeeded."""
    spec = {"tasks": ["arm"], "methods": ["dropo"], "seeds": [0], "preset": "smoke"}
    submitted = service.client.submit_benchmark(spec)
    assert wait_until_finished(service.client, submitted["id"], 120)["states"] == {"succeeded": 3}
    return submitted["id"]

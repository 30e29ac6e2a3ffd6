"""kill -9 in the middle of a benchmark, a new service, and the same bytes in the end."""

import time

import pytest

from adr_service.benchmark.comparison import Outcome, table, to_csv
from adr_service.client import AdrClient
from adr_service.specs import BenchmarkSpec
from adr_service.stages.local import LocalStages
from tests.programs.smoke import iterations
from tests.service import RunningService, start_service, wait_until_finished

# faster: tests/workers/test_schedules.py, and test_upkeep.py, which starts a service anew
pytestmark = [pytest.mark.ray, pytest.mark.slow]
BENCHMARK = {
    "tasks": ["arm"],
    "methods": ["simopt", "dropo"],
    "seeds": [0],
    "preset": "smoke",
    "training": {"max_steps": 1800, "evaluate_every": 900, "start": "previous"},
}
KILL_AFTER = range(1, 11)  # finished stages, of twelve


@pytest.fixture(scope="module")
def uninterrupted() -> tuple[str, int]:
    """The result table, and the number of stages, of the benchmark in this process."""
    stages = LocalStages()
    runs = BenchmarkSpec.model_validate(BENCHMARK).runs()
    outcomes = [Outcome(spec, event) for spec in runs for event in iterations(spec, stages)]
    return to_csv(table(outcomes)), len(stages.executed)


@pytest.mark.parametrize("after", KILL_AFTER)
def test_a_killed_service_goes_on_where_it_was(tmp_path, uninterrupted, after):
    table, stages = uninterrupted
    with start_service(tmp_path, cpus=2) as running:
        id = running.client.submit_benchmark(BENCHMARK)["id"]
        wait_for_stages(running.client, id, after)
        before = finished_stages(running.client, id)
        running.kill()
        first_log = running.started_stages
    with start_service(tmp_path, cpus=2) as running:
        final = wait_until_finished(running.client, id, 180)
        assert final["states"] == {"succeeded": 4}
        assert running.client.results_csv(id) == table
        second_log = running.started_stages
    assert len(before) >= after
    assert not before & set(second_log), "a finished stage ran twice"
    assert len(set(first_log) | set(second_log)) == stages


def test_one_core_gives_the_same_bytes_as_two(tmp_path, uninterrupted):
    with start_service(tmp_path, cpus=1) as running:
        id = running.client.submit_benchmark(BENCHMARK)["id"]
        wait_until_finished(running.client, id, 240)
        assert running.client.results_csv(id) == uninterrupted[0]
        assert len(running.started_stages) == uninterrupted[1]


def test_a_service_that_is_stopped_in_good_order_goes_on_as_well(tmp_path, uninterrupted):
    with start_service(tmp_path, cpus=2) as running:
        id = running.client.submit_benchmark(BENCHMARK)["id"]
        wait_for_stages(running.client, id, 2)
        stop(running)
    with start_service(tmp_path, cpus=2) as running:
        assert wait_until_finished(running.client, id, 180)["states"] == {"succeeded": 4}
        assert running.client.results_csv(id) == uninterrupted[0]


def stop(running: RunningService) -> None:
    """SIGTERM; the process must end by itself."""
    running.process.terminate()
    assert running.process.wait(timeout=60) is not None


def finished_stages(client: AdrClient, id: str) -> set[str]:
    """Digests of the stages that some run of the benchmark has a result of."""
    return {
        item["event"]["digest"]
        for run in client.get(id)["runs"]
        for item in client.get_events(run["id"])
        if item["event"]["type"] == "stage_finished"
    }


def wait_for_stages(client: AdrClient, id: str, count: int) -> None:
    deadline = time.monotonic() + 120
    while len(finished_stages(client, id)) < count:
        assert time.monotonic() < deadline, "the benchmark does not move"
        time.sleep(0.05)

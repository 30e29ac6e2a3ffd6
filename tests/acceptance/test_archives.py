"""Half a benchmark travels to another service, and ends with the bytes of an undisturbed one."""

import pytest

from adr_service.benchmark.comparison import Outcome, table, to_csv
from adr_service.specs import BenchmarkSpec
from adr_service.stages.local import LocalStages
from tests.acceptance.test_crash import BENCHMARK, finished_stages, wait_for_stages
from tests.programs.smoke import iterations
from tests.service import start_service, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]  # a killed service, in test_crash.py, is alike


def test_half_a_benchmark_is_finished_by_another_service(tmp_path):
    archive, one, two = tmp_path / "half.adr", tmp_path / "one", tmp_path / "two"
    one.mkdir(mode=0o700)
    two.mkdir(mode=0o700)
    with start_service(one, cpus=2) as running:
        id = running.client.submit_benchmark(BENCHMARK)["id"]
        wait_for_stages(running.client, id, 4)
        with archive.open("wb") as file:  # while it runs
            running.client.export_archive(id, file)
        running.kill()
    with start_service(two, cpus=2) as running:
        with archive.open("rb") as file:
            added = running.client.import_archive(file)
        assert (added["added"], added["runs"]) == (4, 4)
        brought = finished_stages(running.client, id)
        assert len(brought) >= 4
        running.client.resume(id)
        assert wait_until_finished(running.client, id, 180)["states"] == {"succeeded": 4}
        stages = LocalStages()
        runs = list(BenchmarkSpec.model_validate(BENCHMARK).runs())
        outcomes = [Outcome(spec, event) for spec in runs for event in iterations(spec, stages)]
        assert running.client.results_csv(id) == to_csv(table(outcomes))
        assert not brought & set(running.started_stages), "a stage of the archive ran again"
        assert {stage.digest for stage in stages.executed} == brought | set(running.started_stages)

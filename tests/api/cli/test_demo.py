"""The benchmark of `adr demo`."""

from adr_service.specs import BenchmarkSpec
from api.cli.demo import BENCHMARK


def test_its_benchmark_is_valid_and_small():
    spec = BenchmarkSpec.model_validate(BENCHMARK)
    assert spec.tasks == ["arm"]
    assert len(spec.seeds) == 3

"""The benchmark of `adr demo`."""

from adr_service.specs import BenchmarkSpec
from api.cli.demo import BENCHMARK


def test_its_benchmark_is_valid_and_small():
    spec = BenchmarkSpec.model_validate(BENCHMARK)
    assert spec.tasks == ["arm"]
    assert len(spec.seeds) == 3


def test_a_port_that_is_none_ends_the_demo_before_it_starts(adr_here, monkeypatch, tmp_path):
    """At its end it names where `adr serve` would listen."""
    monkeypatch.setenv("ADR_PORT", "none")
    code, _, errors = adr_here("demo", "--data-dir", str(tmp_path / "demo"))
    assert code == 2
    assert "port" in errors.lower()
    assert "none" in errors
    assert not (tmp_path / "demo").exists()

"""Stored specs whose package is not installed any more, beside others."""

import json

import pytest
from sqlalchemy import select, text

from adr_service.specs import BenchmarkExtension, BenchmarkSpec, LostBenchmark, LostRun
from adr_service.specs.lost import Lost
from db import benchmarks, runs
from db.errors import DatabaseDamaged
from db.models import BenchmarkRow, RunRow
from tests.db.rows import SPEC

GONE = "the method 'median_best' is not installed here: install the package that has it"
GRID = {"tasks": ["arm"], "methods": ["udr"], "preset": "smoke", "seeds": [0]}


def rewritten(database, model, id, change):
    """Change a stored spec, as nothing but time and `pip uninstall` do."""
    with database.write("test") as session:
        row = session.scalars(select(model).where(model.id == id)).one()
        spec = json.loads(row.spec)
        change(spec)
        row.spec = json.dumps(spec)


def without_package(spec):
    spec["method"] = {"name": "median_best", "keep": 3}


def test_a_run_whose_method_is_gone_is_listed_with_what_helps(database):
    lost, _ = (runs.create_run(database, SPEC).id for _ in range(2))
    rewritten(database, RunRow, lost, without_package)
    first, second = runs.list_runs(database)
    assert isinstance(first.spec, LostRun)
    assert first.spec.reason.startswith(GONE)
    assert (first.spec.task, first.spec.seed, first.state) == ("arm", 0, "queued")
    assert second.spec == SPEC
    assert runs.get_run(database, lost) == first


def test_a_run_of_another_version_says_which_field_differs(database):
    run = runs.create_run(database, SPEC).id
    rewritten(database, RunRow, run, lambda spec: spec.update(no_such=1))
    assert "of another version: transfer: there is no field 'no_such'" in (
        runs.get_run(database, run).spec.reason
    )


def test_a_benchmark_whose_method_is_gone_is_listed_and_cannot_be_extended(database):
    id = benchmarks.create_benchmark(database, BenchmarkSpec.model_validate(GRID)).id
    rewritten(database, BenchmarkRow, id, lambda spec: spec["methods"].append("median_best"))
    (found,) = benchmarks.list_benchmarks(database)
    assert isinstance(found.spec, LostBenchmark)
    assert (found.spec.tasks, found.spec.methods) == (["arm"], ["udr", "median_best"])
    assert len(benchmarks.runs_of(database, id)) == 3
    with pytest.raises(Lost, match=GONE):
        benchmarks.extend_benchmark(database, id, BenchmarkExtension(seeds=[1]))


def test_a_benchmark_is_not_extended_while_a_run_of_it_is_lost(database):
    """Its place is taken: it would be computed a second time."""
    id = benchmarks.create_benchmark(database, BenchmarkSpec.model_validate(GRID)).id
    run = benchmarks.runs_of(database, id)[0].id
    rewritten(database, RunRow, run, lambda spec: spec.update(no_such=1))
    with pytest.raises(Lost, match="of another version"):
        benchmarks.extend_benchmark(database, id, BenchmarkExtension(seeds=[1]))


@pytest.mark.parametrize("damage", ["x", "3", "null", "[[1, 2]]", "[" * 100_000])
def test_a_spec_that_is_no_object_is_damage(database, damage):
    run = runs.create_run(database, SPEC).id
    with database.write("test") as session:
        session.execute(text("UPDATE runs SET spec = :damage"), {"damage": damage})
    with pytest.raises(DatabaseDamaged, match="a stored run is no JSON object"):
        runs.get_run(database, run)

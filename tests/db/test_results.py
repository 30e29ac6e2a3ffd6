"""Result tables that are kept for their version."""

from adr_service.events import RunSucceeded
from db import benchmarks, events, results, runs
from tests.db.rows import SPEC, benchmark_spec, count


def test_a_table_is_kept_for_its_version_until_the_run_goes(database):
    run = runs.create_run(database, SPEC)
    assert results.kept_results(database, run.id, "one") is None
    for version, body in (("one", "first"), ("two", "second")):
        results.keep_results(database, run.id, version, body)
        assert results.kept_results(database, run.id, version) == body
    assert results.kept_results(database, run.id, "one") is None
    events.append_event(database, run.id, RunSucceeded())
    runs.delete_run(database, run.id)
    results.keep_results(database, run.id, "three", "computed while the run was deleted")
    assert count(database, "results") == 0


def test_deleting_a_benchmark_deletes_the_tables_of_its_runs_too(database):
    spec = benchmark_spec()
    benchmark = benchmarks.create_benchmark(database, spec)
    (run, *_) = members = benchmarks.runs_of(database, benchmark.id)
    for member in members:
        events.append_event(database, member.id, RunSucceeded())
    for id in (benchmark.id, run.id):
        results.keep_results(database, id, "one", "table")
    benchmarks.delete_benchmark(database, benchmark.id)
    assert count(database, "results") == 0

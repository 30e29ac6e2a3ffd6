"""Benchmarks: grids of runs that are stored, extended and deleted as one."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from adr_service.errors import InvalidInput
from adr_service.events import RunFailed, RunStopped, RunSucceeded, StageFinished
from adr_service.json_values import canonical_json
from adr_service.plugins import METHODS, TASKS
from adr_service.presets import PRESETS
from adr_service.specs import BenchmarkExtension, BenchmarkSpec
from adr_service.stages.catalogue import VERSIONS
from adr_service.stages.evaluate import Evaluate
from adr_service.stages.propose import Propose
from db import benchmarks, events, runs, stages
from db.errors import NotFound, NotPossible
from tests.db.rows import (
    EXECUTION,
    RESULT,
    SPEC,
    benchmark_spec,
    commit,
    count,
    statements,
)
from tests.packages import add_entry_point
from tests.stages.examples import evaluation


def test_a_benchmark_is_stored_with_all_its_runs(database):
    spec = benchmark_spec(seeds=[0, 1])
    record = benchmarks.create_benchmark(database, spec)
    assert benchmarks.get_benchmark(database, record.id) == record
    assert [r.spec for r in benchmarks.runs_of(database, record.id)] == list(spec.runs())


def test_a_large_benchmark_takes_no_more_statements_than_a_small_one(file_database):
    """5,000 runs held the lock for 12 seconds, statement by statement."""
    given = {"tasks": ["arm"], "methods": ["simopt"], "preset": "smoke"}
    counts = []
    for seeds in (1, 40):
        spec = BenchmarkSpec.model_validate({**given, "seeds": list(range(seeds))})
        with statements() as executed:
            id = benchmarks.create_benchmark(file_database, spec).id
        counts.append(len(executed))
        with statements() as executed:
            benchmarks.extend_benchmark(file_database, id, BenchmarkExtension(seeds=[1000 + seeds]))
        counts.append(len(executed))
    assert counts[:2] == counts[2:]


def test_all_runs_of_a_benchmark_that_stopped_are_queued_again_in_batches(database, monkeypatch):
    monkeypatch.setattr(runs, "_AT_ONCE", 2)
    given = {"tasks": ["arm"], "methods": ["simopt"], "preset": "smoke", "seeds": [0, 1]}
    id = benchmarks.create_benchmark(database, BenchmarkSpec.model_validate(given)).id
    *stopped, done = benchmarks.runs_of(database, id)
    assert {run.id for run in benchmarks.request_cancel_all(database, id)} == {
        run.id for run in [*stopped, done]
    }
    events.append_event(database, done.id, RunSucceeded())
    for batch in runs.batches([(run.id, RunStopped(submission=1)) for run in stopped]):
        events.append_events(database, batch)
    queued = list(benchmarks.resubmit_all(database, id))
    assert [run.id for run in queued] == [run.id for run in stopped]
    assert {(run.state, run.submission, run.cancel_requested) for run in queued} == {
        ("queued", 2, False)
    }
    assert list(benchmarks.resubmit_all(database, id)) == []


def test_a_benchmark_is_deleted_whole_and_only_when_finished(database):
    spec = benchmark_spec()
    benchmark = benchmarks.create_benchmark(database, spec)
    with pytest.raises(NotPossible, match="not finished"):
        benchmarks.delete_benchmark(database, benchmark.id)
    for run in benchmarks.runs_of(database, benchmark.id):
        events.append_event(database, run.id, RunSucceeded())
        with pytest.raises(NotPossible, match="delete the benchmark"):
            runs.delete_run(database, run.id)
    benchmarks.delete_benchmark(database, benchmark.id)
    assert [count(database, t) for t in ("benchmarks", "runs", "events")] == [0, 0, 0]


def test_an_extension_adds_the_missing_runs_alone(database):
    given = {"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke"}
    id = benchmarks.create_benchmark(database, BenchmarkSpec.model_validate(given)).id
    before = benchmarks.runs_of(database, id)
    added = benchmarks.extend_benchmark(
        database, id, BenchmarkExtension.model_validate({"seeds": [1], "methods": ["droid"]})
    )
    assert benchmarks.runs_of(database, id) == [*before, *added]
    cells = [(run.spec.method.name, run.spec.seed) for run in added]
    names = ("udr", "droid", "prior", "oracle")
    assert cells == [("droid", 0), *((name, 1) for name in names)]
    assert benchmarks.get_benchmark(database, id).spec.seeds == [0, 1]
    for refused, message in (({"seeds": [1]}, "has the seeds 1 already"), ({}, "nothing to add")):
        with pytest.raises(InvalidInput, match=message):
            benchmarks.extend_benchmark(database, id, BenchmarkExtension.model_validate(refused))
    assert len(benchmarks.runs_of(database, id)) == len(before) + len(added)


@pytest.mark.parametrize("extension", [{"methods": ["prior"]}, {"collectors": ["random"]}])
def test_an_extension_that_adds_no_run_is_refused(database, extension):
    """A reference is there already, and no method here learns from recordings."""
    given = {"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke"}
    record = benchmarks.create_benchmark(database, BenchmarkSpec.model_validate(given))
    with pytest.raises(InvalidInput, match="the extension adds no run"):
        benchmarks.extend_benchmark(
            database, record.id, BenchmarkExtension.model_validate(extension)
        )
    assert benchmarks.get_benchmark(database, record.id) == record


def test_a_benchmark_does_not_grow_by_runs_of_another_budget(database, monkeypatch):
    given = {"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke"}
    id = benchmarks.create_benchmark(database, BenchmarkSpec.model_validate(given)).id
    monkeypatch.setitem(PRESETS["smoke"]["run"], "transitions", 30)
    monkeypatch.setitem(PRESETS["smoke"]["run"]["training"], "backend", "sbx")
    differ = r"transitions \(20 there, 30 now\), training.backend \('sb3' there, 'sbx' now\)"
    with pytest.raises(NotPossible, match=rf"those that bench_\w+ has in {differ}, and would not"):
        benchmarks.extend_benchmark(database, id, BenchmarkExtension.model_validate({"seeds": [1]}))


@pytest.mark.parametrize(
    ("group", "stage"),
    [
        (TASKS, replace(evaluation(task="upgraded"), package="broken 0.9")),
        (
            METHODS,
            Propose(
                task="arm",
                variant="vanilla",
                seed=0,
                method={"name": "upgraded"},
                method_package="broken 0.9",
                distributions=[],
                returns=[],
            ),
        ),
    ],
)
def test_a_benchmark_of_another_version_is_neither_extended_nor_resumed(
    database, tmp_path, monkeypatch, group, stage
):
    add_entry_point(tmp_path, group, "math:pi", "upgraded")
    monkeypatch.syspath_prepend(tmp_path)
    id = benchmarks.create_benchmark(database, benchmark_spec()).id
    commit(database, stage, RESULT, benchmarks.runs_of(database, id)[0].id)
    message = "was computed with broken 0.9, and broken 1.0 is installed; submit it anew"
    check_that_it_goes_on_no_more(database, id, f"{id} {message}")


def check_that_it_goes_on_no_more(database, id, message):
    """Nor does a run of it that has computed nothing itself."""
    more = BenchmarkExtension.model_validate({"seeds": [1]})
    for extend in (benchmarks.planned_extension, benchmarks.extend_benchmark):
        with pytest.raises(InvalidInput, match=message):
            extend(database, id, more)
    with pytest.raises(InvalidInput, match=message):
        runs.resubmit(database, benchmarks.runs_of(database, id)[-1].id)
    with pytest.raises(InvalidInput, match=message):
        next(benchmarks.resubmit_all(database, id))


def test_a_benchmark_with_another_version_of_a_kind_of_stage_goes_on_no_more(database, monkeypatch):
    """New seeds stood beside old ones in one row, without a word."""
    id = benchmarks.create_benchmark(database, benchmark_spec()).id
    first, *_ = benchmarks.runs_of(database, id)
    commit(database, evaluation(1), RESULT, first.id)
    now = VERSIONS["evaluate"]
    monkeypatch.setitem(VERSIONS, "evaluate", now + 1)
    message = f"stages of version {now} of evaluate, and this service computes version {now + 1}"
    check_that_it_goes_on_no_more(database, id, f"{id} has {message}; submit it anew")


def test_versions_are_listed_by_kind_of_stage_and_by_package(database, monkeypatch):
    run_id = runs.create_run(database, SPEC).id
    for package in ("one 1.0", "one 1.1"):
        commit(database, replace(evaluation(1), package=package), RESULT, run_id)
    now = Evaluate.version
    monkeypatch.setattr(Evaluate, "version", 10 * now)
    commit(database, evaluation(2), RESULT, run_id)
    strange = {"kind": "x", "package": "other 7", "version": 3}  # as a stranger's archive may have
    with database.write("test") as session:
        stages.add_result(session, "f" * 64, canonical_json(strange), RESULT, EXECUTION)
        events.append(session, run_id, StageFinished(kind="x", digest="f" * 64))
    with database.read() as session:
        found = stages.versions_of(session, [run_id, "run_without"])
    assert found.kinds == {("evaluate", str(now)), ("evaluate", str(10 * now)), ("x", "3")}
    assert found.packages == {("one", "1.0"), ("one", "1.1"), ("other", "7")}
    assert len(stages.packaged_inputs(database, [run_id])) == 2


def test_a_benchmark_grows_where_its_packages_have_the_version_that_computed_it(
    database, tmp_path, monkeypatch
):
    add_entry_point(tmp_path, TASKS, "math:pi", "as_it_was")
    monkeypatch.syspath_prepend(tmp_path)
    id = benchmarks.create_benchmark(database, benchmark_spec()).id
    stage = replace(evaluation(task="as_it_was"), package="broken 1.0")
    commit(database, stage, RESULT, benchmarks.runs_of(database, id)[0].id)
    more = BenchmarkExtension.model_validate({"seeds": [1]})
    assert benchmarks.extend_benchmark(database, id, more)


def test_states_count_the_runs_of_each_benchmark(database):
    ids = [benchmarks.create_benchmark(database, benchmark_spec()).id for _ in range(2)]
    (first, *rest) = benchmarks.runs_of(database, ids[0])
    events.append_event(database, first.id, RunSucceeded())
    assert benchmarks.states_of(database, ids) == {
        ids[0]: {"succeeded": 1, "queued": len(rest)},
        ids[1]: {"queued": 1 + len(rest)},
    }


def test_unknown_benchmark_is_named_in_the_error(database):
    for ask in (benchmarks.get_benchmark, benchmarks.runs_of, benchmarks.delete_benchmark):
        with pytest.raises(NotFound, match="no benchmark 'bench_x'"):
            ask(database, "bench_x")


def test_the_latest_come_first(database):
    ids = [runs.create_run(database, SPEC).id for _ in range(3)]
    assert [run.id for run in benchmarks.latest(database, 2)[1]] == ids[:0:-1]


def test_retention_keeps_what_went_on_after_its_list_was_made(database):
    whole = benchmarks.create_benchmark(database, benchmark_spec(seeds=[0])).id
    alone = runs.create_run(database, SPEC).id
    ids = [alone, *(run.id for run in benchmarks.runs_of(database, whole))]
    for id in ids:
        events.append_event(database, id, RunFailed(submission=1, code="x", message="why"))
    deletions = benchmarks.finished_before(database, datetime.now(UTC))
    assert len(deletions) == 2
    for id in ids:
        runs.resubmit(database, id)
        events.append_event(database, id, RunSucceeded())
    for delete, id in deletions:
        with pytest.raises(NotPossible, match="has changed meanwhile"):
            delete(database, id)


def test_retention_deletes_what_ended_before_and_nothing_live_or_recent(database):
    spec = benchmark_spec(seeds=[0, 1])
    whole, half = (benchmarks.create_benchmark(database, spec).id for _ in range(2))
    ended, live = (runs.create_run(database, SPEC).id for _ in range(2))
    members = [run.id for run in benchmarks.runs_of(database, whole)]
    for id in [*members, *(run.id for run in benchmarks.runs_of(database, half)[1:]), ended]:
        events.append_event(database, id, RunSucceeded())
    later = datetime.now(UTC)
    deletions = benchmarks.finished_before(database, later)
    assert [id for _, id in deletions] == [whole, ended]
    assert benchmarks.finished_before(database, later - timedelta(hours=1)) == []
    for delete, id in deletions:
        delete(database, id)
    left = {run.id for run in runs.list_runs(database)}
    assert left == {run.id for run in benchmarks.runs_of(database, half)} | {live}

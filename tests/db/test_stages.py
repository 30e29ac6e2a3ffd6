"""Results of stages, their artifacts, checkpoints and executions."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest
from sqlalchemy import text

from adr_service.events import (
    RunSucceeded,
    TrainingEvaluated,
)
from adr_service.stages.base import StageResult
from db import events, runs, stages
from db.errors import (
    NotFound,
)
from tests.db.rows import (
    EXECUTION,
    RESULT,
    SPEC,
    STAGE,
    UNMEASURED,
    commit,
    count,
    stored,
)
from tests.stages.examples import evaluation


def test_a_result_comes_back_to_the_last_digit(database):
    run = runs.create_run(database, SPEC)
    assert stored(database, STAGE.digest) is None
    commit(database, STAGE, RESULT, run.id)
    assert stored(database, STAGE.digest) == RESULT


def test_a_stage_is_committed_once_and_tells_every_run(database):
    first, second = (runs.create_run(database, SPEC) for _ in range(2))
    commit(database, STAGE, RESULT, first.id)
    commit(database, STAGE, StageResult({"other": 1}), first.id, second.id)
    assert stored(database, STAGE.digest) == RESULT
    for run in (first, second):
        kinds = [record.event.type for record in events.events_of(database, run.id)]
        assert kinds.count("stage_finished") == 1


def test_nothing_of_a_commit_stays_when_a_part_of_it_fails(database):
    with pytest.raises(NotFound):
        commit(database, STAGE, RESULT, "run_that_is_not_there")
    assert [count(database, t) for t in ("stages", "artifacts", "events")] == [0, 0, 0]


def test_equal_bytes_are_stored_once(database):
    run = runs.create_run(database, SPEC)
    for x in (1, 2):
        commit(database, evaluation(x), StageResult({}, {"p": b"same"}), run.id)
    assert count(database, "artifacts") == 1


def test_deleting_a_run_frees_what_only_it_refers_to(database):
    first, second = (runs.create_run(database, SPEC) for _ in range(2))
    commit(database, STAGE, RESULT, first.id, second.id)
    own = evaluation(2)
    commit(database, own, StageResult({}, {"p": b"own"}), first.id)
    for run in (first, second):
        events.append_event(database, run.id, RunSucceeded())
    runs.delete_run(database, first.id)
    assert stored(database, own.digest) is None
    assert stored(database, STAGE.digest) == RESULT
    runs.delete_run(database, second.id)
    tables = ("runs", "events", "stages", "artifacts", "stage_artifacts")
    assert [count(database, table) for table in tables] == [0] * 5


def test_an_execution_comes_back_whole(database):
    run = runs.create_run(database, SPEC)
    commit(database, STAGE, RESULT, run.id)
    assert stages.executions_of(database, [run.id]) == [("evaluate", EXECUTION)]
    assert stages.cpu_seconds_of(database, [STAGE.digest, "another"]) == pytest.approx(
        {STAGE.digest: 0.4 - 0.1}
    )


def test_executions_between_two_moments_are_those_that_overlap_them(database):
    now = datetime.now(UTC).timestamp()
    recent = replace(EXECUTION, placed=now - 2, began=now - 1, ended=now)
    commit(database, STAGE, RESULT, execution=recent)
    assert stages.executions_between(database, now - 1, now) == [recent]
    assert stages.executions_between(database, now - 9, now - 3) == []


def test_an_execution_overlaps_what_ended_hours_before_it(database):
    """Its core was busy then, with a long training."""
    now = datetime.now(UTC).timestamp()
    long = replace(EXECUTION, placed=now - 9 * 3600, began=now - 9 * 3600, ended=now)
    commit(database, STAGE, RESULT, execution=long)
    assert stages.executions_between(database, now - 9 * 3600, now - 5 * 3600) == [long]


def test_a_stage_whose_compilations_took_longer_than_its_cpu_has_computed_nothing(database):
    """JAX tells the time of compilations by another clock."""
    commit(database, STAGE, RESULT, execution=replace(EXECUTION, cpu=3.3, preparing=3.6))
    assert stages.cpu_seconds_of(database, [STAGE.digest]) == {STAGE.digest: 0.0}


def test_an_episode_that_took_no_core_is_not_measured(database):
    run = runs.create_run(database, SPEC)
    commit(database, STAGE, RESULT, run.id, execution=UNMEASURED)
    assert stages.executions_of(database, [run.id]) == []
    assert stages.cpu_seconds_of(database, [STAGE.digest]) == {}


def test_the_timing_column_keeps_its_form(database):
    """Databases of earlier versions are read, and later rows look like theirs."""
    commit(database, STAGE, RESULT)
    commit(database, evaluation(2), RESULT, execution=UNMEASURED)
    with database.read() as session:
        rows = session.execute(text("select timing from stages")).scalars().all()
    assert set(rows) == {
        '{"asked":100.0,"began":101.5,"cores":2,"cpu":0.4,"ended":102.0,"is_first":true,'
        '"placed":101.0,"preparing":0.1}',
        None,
    }


def test_the_best_policy_so_far_can_be_had_until_there_is_the_final_one(database):
    run = runs.create_run(database, SPEC)
    for steps, policy in ((10, b"poor"), (20, b"better"), (30, b"better")):
        with database.write("test") as session:
            stages.note_checkpoint(session, STAGE.digest, steps, policy)
        assert stages.policy_of_training(database, STAGE.digest) == policy
        assert count(database, "artifacts") == 1
    with database.write("test") as session:  # its process was lost, and it starts again
        stages.note_checkpoint(session, STAGE.digest, 10, b"poor")
    assert stages.policy_of_training(database, STAGE.digest) == b"better"
    commit(database, STAGE, StageResult({}, {"policy": b"best"}), run.id)
    assert stages.policy_of_training(database, STAGE.digest) == b"best"
    with database.write("test") as session:  # it comes late
        stages.note_checkpoint(session, STAGE.digest, 40, b"better")
    assert [count(database, t) for t in ("checkpoints", "artifacts")] == [0, 1]


def test_a_policy_so_far_stays_as_long_as_a_run_speaks_of_it(database):
    """A training that was cancelled has no more than that."""
    one, other = (runs.create_run(database, SPEC) for _ in range(2))
    point = TrainingEvaluated(digest=STAGE.digest, steps=10, mean_return=1.0, standard_error=0.1)
    with database.write("test") as session:
        stages.note_checkpoint(session, STAGE.digest, 10, b"so far")
        events.append(session, one.id, point)
    for run, left in ((other, 1), (one, 0)):
        events.append_event(database, run.id, RunSucceeded())
        runs.delete_run(database, run.id)
        assert [count(database, t) for t in ("checkpoints", "artifacts")] == [left, left]

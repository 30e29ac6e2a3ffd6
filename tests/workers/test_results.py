"""Results in the database, and trouble with it as a value."""

from concurrent.futures import Future

import pytest

from adr_service.errors import StageFailed
from adr_service.events import RunFailed, TrainingEvaluated
from adr_service.progress import Checkpoint
from adr_service.stages.base import StageResult
from db import events, runs, stages, visits
from db.errors import DatabaseUnavailable
from db.visits import LeaseLost
from tests.db.rows import EXECUTION, SPEC, commit
from tests.stages.examples import episode, rollout, training
from workers import results
from workers.actors import Finished
from workers.job_table import JobTable
from workers.results import (
    Beginning,
    DatabaseResults,
    Outcome,
    Refused,
    Retries,
    Unavailable,
    attempted,
)

IDS = {"run": "run_a"}
STAGE = training()
RESULT = STAGE.stand_in().to_stored()
VISIT = rollout()
ROLLOUT = StageResult({"transitions": 10}, {"data": b"recorded"})


def events_of(database, run_id, kind):
    return [each for each in events.events_of(database, run_id) if each.event.type == kind]


def raising(error):
    def action():
        raise error

    return action


def test_a_result_is_written_to_the_runs_that_waited_and_to_those_that_find_it(database):
    store = DatabaseResults(database)
    waited, later = (runs.create_run(database, SPEC).id for _ in range(2))
    assert store.find(STAGE, waited) is None
    store.commit([Outcome(STAGE, RESULT, EXECUTION, None, [waited, "run_deleted_meanwhile"])])
    assert store.find(STAGE, later) == RESULT
    for run_id in (waited, later):
        (event,) = events_of(database, run_id, "stage_finished")
        assert event.event.digest == STAGE.digest


def test_a_result_that_was_imported_meanwhile_is_the_one_that_runs_get(database):
    """The same training on another type of CPU has another policy."""
    imported = StageResult(RESULT.values, {**RESULT.blobs, "policy": b"of another CPU"})
    store, run_id = DatabaseResults(database), runs.create_run(database, SPEC).id
    table, future = JobTable(store), Future()
    table.accept(STAGE, run_id, future)
    (job,) = table.ready()
    table.begin([job], ["actor"])
    commit(database, STAGE, imported)
    table.end([(job, Finished(RESULT, EXECUTION))])
    assert future.result(timeout=0) == store.find(STAGE, run_id) == imported


def test_a_simulated_visit_is_completed_under_its_last_lease_alone(database):
    store, run_id = DatabaseResults(database), runs.create_run(database, SPEC).id
    begun = [Beginning(training(), run_id, "actor"), Beginning(VISIT, run_id, "lost")]
    none, first = store.begin(begun)
    (second,) = store.begin([Beginning(VISIT, run_id, "next")])
    assert none is None
    with pytest.raises(LeaseLost):
        store.commit([Outcome(VISIT, ROLLOUT, EXECUTION, first, [run_id])])
    assert store.find(VISIT, run_id) is None
    store.commit([Outcome(VISIT, ROLLOUT, EXECUTION, second, [run_id])])
    assert [visit.state for visit in visits.list_visits(database)] == ["done"]


def test_a_dropped_visit_leaves_no_row(database):
    store, run_id = DatabaseResults(database), runs.create_run(database, SPEC).id
    store.begin([Beginning(VISIT, run_id, "actor")])
    store.drop(VISIT)
    assert visits.list_visits(database) == []


def test_a_robots_stage_is_offered_when_a_run_asks_for_it(database):
    store, run_id = DatabaseResults(database), runs.create_run(database, SPEC).id
    asked = episode(run_id)
    for _ in range(2):
        assert store.find(asked, run_id) is None
    (visit,) = visits.list_visits(database)
    assert (visit.digest, visit.state, visit.external) == (asked.digest, "pending", True)


def test_a_robots_stage_is_not_offered_for_a_run_that_was_asked_to_stop(database):
    """Its question may still be on its way when the run ends; nobody would withdraw the visit."""
    store, run_id = DatabaseResults(database), runs.create_run(database, SPEC).id
    runs.request_cancel(database, run_id)
    assert store.find(episode(run_id), run_id) is None
    assert visits.list_visits(database) == []


@pytest.mark.parametrize("is_deleted", [False, True])
def test_a_robots_stage_of_a_run_that_has_ended_fails_at_once(database, is_deleted):
    """A robot that cannot do a visit may say so before the run's thread asks for it again."""
    store, run_id = DatabaseResults(database), runs.create_run(database, SPEC).id
    failed = RunFailed(submission=1, code="target_failed", message="the gripper is broken")
    events.append_event(database, run_id, failed)
    if is_deleted:
        runs.delete_run(database, run_id)
    table, future = JobTable(store), Future()
    table.accept(episode(run_id), run_id, future)
    with pytest.raises(StageFailed, match=f"{run_id} has ended, and visits no robot"):
        future.result(timeout=0)
    assert visits.list_visits(database) == []


def test_a_failure_that_was_stored_without_an_answer_ends_the_wait(database):
    """`Orchestrator.fail_task` says `arrived`, because it does not know whether it was stored."""
    store, run_id = DatabaseResults(database), runs.create_run(database, SPEC).id
    table, future, asked = JobTable(store), Future(), episode(run_id)
    table.accept(asked, run_id, future)
    table.arrived(asked.digest)
    assert not future.done()  # it was not stored
    failed = RunFailed(submission=1, code="target_failed", message="the gripper is broken")
    events.append_event(database, run_id, failed)
    table.arrived(asked.digest)
    with pytest.raises(StageFailed, match=f"{run_id} has ended"):
        future.result(timeout=0)
    assert len(table) == 0


def test_a_checkpoint_has_its_learning_curve_on_the_runs_record(database):
    store, run_id = DatabaseResults(database), runs.create_run(database, SPEC).id
    stage = training()
    point = TrainingEvaluated(digest=stage.digest, steps=10, mean_return=1.0, standard_error=0.1)
    store.note(stage, Checkpoint(10, b"so far", (point,)), [run_id])
    (event,) = events_of(database, run_id, "training_evaluated")
    assert event.event.steps == 10
    assert stages.policy_of_training(database, stage.digest) == b"so far"


def test_trouble_is_a_value_and_is_logged_with_its_stage(caplog):
    assert attempted("it failed", IDS, len, "four") == 4
    passing = raising(DatabaseUnavailable("locked"))
    assert attempted("the look-up failed", IDS, passing) == Unavailable()
    error = OSError("read-only")
    assert attempted("the look-up failed", IDS, raising(error)) == Refused(error)
    assert [record.run for record in caplog.records] == ["run_a"] * 2
    assert "the look-up failed just now: locked" in caplog.text


def test_retries_keep_their_order_and_end_at_the_first_that_fails_again(monkeypatch):
    done, retries = [], Retries()
    monkeypatch.setattr(results, "RETRY_S", 0.0)

    def fail_again():
        done.append("b")
        monkeypatch.setattr(results, "RETRY_S", 60.0)
        retries.add(lambda: done.append("later"))

    retries.add(lambda: done.append("a"))
    retries.add(lambda: done.append("withdrawn"), "run_x")
    retries.add(fail_again)
    retries.add(lambda: done.append("c"))
    retries.withdraw("run_x")
    retries.run_due()
    assert done == ["a", "b"]

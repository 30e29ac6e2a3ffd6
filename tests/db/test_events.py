"""Events of runs, each written once."""

from datetime import UTC, datetime

import pytest
from sqlalchemy import insert

from adr_service.errors import InvalidInput
from adr_service.events import (
    IterationFinished,
    RunFailed,
    RunQueued,
    RunStarted,
    RunStopped,
    RunSucceeded,
    state_after,
)
from db import events, runs
from db.errors import NotFound
from db.models import EventRow
from tests.db.rows import SPEC


def test_an_event_is_written_once(database):
    run = runs.create_run(database, SPEC)
    assert events.append_event(database, run.id, RunStarted(submission=1))
    assert not events.append_event(database, run.id, RunStarted(submission=1))
    assert [e.seq for e in events.events_of(database, run.id)] == [1, 2]


def test_the_state_is_the_fold_of_the_events(database):
    run = runs.create_run(database, SPEC)
    failed = RunFailed(submission=1, code="worker_lost", message="gone")
    story = [RunStarted(submission=1), failed, RunQueued(submission=2)]
    story += [RunStarted(submission=2), RunStopped(submission=2), RunSucceeded()]
    for event in story:
        events.append_event(database, run.id, event)
        written = [e.event for e in events.events_of(database, run.id)]
        assert runs.get_run(database, run.id).state == state_after(written)


def test_an_earlier_submission_does_not_end_a_run_that_was_submitted_again(database):
    """A robot's refusal ends a run before its thread sees that a user has asked it to stop."""
    run = runs.create_run(database, SPEC)
    failed = RunFailed(submission=1, code="worker_lost", message="gone")
    events.append_event(database, run.id, failed)
    again = runs.resubmit(database, run.id)
    assert not events.append_event(database, run.id, RunStopped(submission=1))
    assert runs.get_run(database, run.id) == again
    assert events.append_event(database, run.id, RunStopped(submission=2))


def test_a_batch_skips_runs_that_were_deleted_meanwhile(database):
    run = runs.create_run(database, SPEC)
    started = RunStarted(submission=1)
    events.append_events(database, [("run_gone", started), (run.id, started)])
    with database.write("test") as session:
        events.append_to_all(session, ["run_gone", run.id], [started, RunSucceeded()])
    types = [e.event.type for e in events.events_of(database, run.id)]
    assert types == ["run_queued", "run_started", "run_succeeded"]


def test_an_event_of_an_unknown_run_is_refused(database):
    with pytest.raises(NotFound, match="no run 'run_x'"):
        events.append_event(database, "run_x", RunSucceeded())


def test_iterations_come_in_the_order_of_the_runs(database):
    first, second = (runs.create_run(database, SPEC).id for _ in range(2))
    for run_id, iteration in ((first, 0), (second, 0), (first, 1)):
        events.append_event(database, run_id, an_iteration(iteration))
    ids = [second, first]
    assert events.count_iterations(database, ids) == [(second, 1), (first, 2)]
    assert [
        (id, event.iteration) for id, event in events.all_of(database, ids, IterationFinished)
    ] == [
        (second, 0),
        (first, 0),
        (first, 1),
    ]


def test_an_iteration_that_comes_out_otherwise_is_refused(database):
    """A run that is resumed with a corrected method would mix the answers of both."""
    run = runs.create_run(database, SPEC)
    assert events.append_event(database, run.id, an_iteration(1))
    assert not events.append_event(database, run.id, an_iteration(1)), "the same again"
    other = an_iteration(1).model_copy(update={"inferences": ["f" * 64]})
    with pytest.raises(InvalidInput, match=r"iteration 1 came out otherwise .* submit a new run"):
        events.append_event(database, run.id, other)
    assert len(events.events_of(database, run.id)) == 2


def test_an_iteration_of_an_early_version_lacks_fields_and_is_no_other(database):
    run = runs.create_run(database, SPEC)
    early = an_iteration(1)
    assert "inferences" not in early.model_fields_set
    with database.write("test") as session:
        body = early.model_dump_json(exclude={"inferences", "diverged_episodes"})
        row = {"run_id": run.id, "seq": 2, "key": early.key, "type": early.type, "body": body}
        session.execute(insert(EventRow).values(**row, created_at=datetime.now(UTC)))
    now = early.model_copy(update={"inferences": ["f" * 64]})
    assert not events.append_event(database, run.id, now)


def an_iteration(number):
    empty = {name: [] for name in ("distributions", "policies", "source_returns", "returns")}
    empty |= {name: [] for name in ("reached_threshold", "training_steps")}
    counts = dict.fromkeys(("target_rollouts", "target_transitions", "evaluation_episodes"), 0)
    return IterationFinished(iteration=number, inference_steps=0, diagnostics={}, **counts, **empty)

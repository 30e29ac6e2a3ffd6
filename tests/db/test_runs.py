"""Runs that are submitted, cancelled, resumed and deleted."""

import pytest

from adr_service.events import RunFailed, RunStopped, RunSucceeded
from db import events, runs
from db.errors import NotFound, NotPossible
from tests.db.finished import proceed
from tests.db.rows import SPEC


def test_a_stored_run_comes_back_whole_and_queued(database):
    record = runs.create_run(database, SPEC)
    assert runs.get_run(database, record.id) == record
    assert (record.spec, record.state, record.submission) == (SPEC, "queued", 1)
    assert record.created_at.tzinfo is not None


def test_a_failure_has_its_error_until_the_run_goes_on(database):
    run = runs.create_run(database, SPEC)
    events.append_event(database, run.id, RunFailed(submission=1, code="x", message="why"))
    record = runs.get_run(database, run.id)
    assert (record.error_code, record.error_message) == ("x", "why")
    again = runs.resubmit(database, run.id)
    assert (again.state, again.submission, again.error_code) == ("queued", 2, None)


def test_unfinished_runs_come_in_order_without_those_that_are_known(database):
    first, known, done, last = (runs.create_run(database, SPEC) for _ in range(4))
    events.append_event(database, done.id, RunFailed(submission=1, code="x", message="why"))
    events.append_event(database, known.id, RunFailed(submission=1, code="x", message="why"))
    runs.resubmit(database, known.id)
    keys = [(known.id, 2), (last.id, 7)]  # of another submission
    assert [run.id for run in runs.unfinished_runs(database, keys)] == [first.id, last.id]


def test_pages_follow_the_order_of_submission(database):
    ids = [runs.create_run(database, SPEC).id for _ in range(5)]
    first = runs.list_runs(database, limit=2)
    rest = runs.list_runs(database, after=first[-1].number)
    assert [r.id for r in first + rest] == ids
    newest = runs.list_runs(database, limit=2, newest_first=True)
    assert [r.id for r in newest] == [ids[4], ids[3]]


def test_a_run_that_was_stopped_meanwhile_does_not_begin(database):
    """It would be running for ever: its second stop would be known."""
    run = runs.create_run(database, SPEC)
    runs.request_cancel(database, run.id)
    events.append_event(database, run.id, RunStopped(submission=1))
    assert runs.begin(database, run) is None
    assert runs.get_run(database, run.id).state == "cancelled"
    again = runs.resubmit(database, run.id)
    assert runs.begin(database, run) is None  # it is of the submission before
    begun = runs.begin(database, again)
    assert begun == runs.get_run(database, run.id)
    assert begun.state == "running"
    assert runs.begin(database, begun).state == "running"  # after the service started again


def test_unknown_run_is_named_in_the_error(database):
    with pytest.raises(NotFound, match="no run 'run_x'"):
        runs.get_run(database, "run_x")


def test_only_live_runs_are_cancelled_and_only_ended_ones_resumed_or_deleted(database):
    run = runs.create_run(database, SPEC)
    with pytest.raises(NotPossible, match="only a failed or cancelled run"):
        runs.resubmit(database, run.id)
    with pytest.raises(NotPossible, match="cancel it before"):
        runs.delete_run(database, run.id)
    assert runs.request_cancel(database, run.id).cancel_requested
    events.append_event(database, run.id, RunSucceeded())
    with pytest.raises(NotPossible, match="only a live run"):
        runs.request_cancel(database, run.id)


def test_finished_iterations_are_counted_by_run(database):
    one, other = (runs.create_run(database, SPEC) for _ in range(2))
    proceed(database, one)
    assert runs.finished_iterations(database, ["arm", "hopper"], ["prior"]) == {one.id: 1}
    assert runs.finished_iterations(database, ["hopper"], ["prior"]) == {}
    assert runs.finished_iterations(database, ["arm"], ["udr"]) == {}
    proceed(database, other)
    assert runs.finished_iterations(database, ["arm"], ["prior"]) == {one.id: 1, other.id: 1}

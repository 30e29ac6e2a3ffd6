"""States of a run, and the events that lead from one to the next."""

import itertools

import pytest

from adr_service.events import (
    FINISHED,
    RunFailed,
    RunQueued,
    RunStarted,
    RunState,
    RunStopped,
    RunSucceeded,
    StageFinished,
    next_state,
    state_after,
)

LIFECYCLE = {
    RunQueued(submission=1): RunState.QUEUED,
    RunStarted(submission=1): RunState.RUNNING,
    RunSucceeded(): RunState.SUCCEEDED,
    RunFailed(submission=1, code="internal", message="a defect"): RunState.FAILED,
    RunStopped(submission=1): RunState.CANCELLED,
}


def test_every_state_is_reached_by_one_lifecycle_event():
    assert set(LIFECYCLE.values()) == set(RunState)
    for (event, after), before in itertools.product(LIFECYCLE.items(), RunState):
        assert next_state(before, event) is after


@pytest.mark.parametrize("state", RunState)
def test_a_science_event_leaves_the_state(state):
    assert next_state(state, StageFinished(kind="infer", digest="x")) is state


def test_the_state_depends_on_the_last_lifecycle_event_alone():
    for events in itertools.permutations(LIFECYCLE, 3):
        assert state_after(events) is LIFECYCLE[events[-1]]
    assert state_after([]) is RunState.QUEUED


def test_failed_and_cancelled_runs_are_finished_and_resumable_and_succeeded_ones_finished():
    assert {state for state in RunState if state.is_finished} == FINISHED
    assert FINISHED - {state for state in RunState if state.is_resumable} == {RunState.SUCCEEDED}
    assert not RunState.QUEUED.is_resumable
    assert not RunState.RUNNING.is_resumable


def test_states_have_the_values_of_the_api():
    assert list(RunState) == ["queued", "running", "succeeded", "failed", "cancelled"]

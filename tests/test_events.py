import itertools
import json

import pytest

from adr_service.events import (
    FINISHED,
    CriticismFinished,
    IterationFinished,
    RunFailed,
    RunQueued,
    RunStarted,
    RunState,
    RunStopped,
    RunSucceeded,
    StageFinished,
    TrainingEvaluated,
    event_from_json,
    next_state,
    state_after,
)

EVENTS = [
    RunQueued(submission=1),
    RunStarted(submission=1),
    StageFinished(kind="evaluate", digest="0" * 64),
    TrainingEvaluated(digest="0" * 64, steps=40, mean_return=1 / 3, standard_error=0.0),
    IterationFinished(
        iteration=1,
        target_rollouts=1,
        target_transitions=20,
        evaluation_episodes=2,
        distributions=[{"kind": "uniform", "low": [0.1], "high": [1 / 3]}],
        policies=["a"],
        source_returns=[1.5],
        reached_threshold=[False],
        training_steps=[600],
        inference_steps=0,
        returns=[[1.0, 2.0]],
        diagnostics={"a": [None, 1e-300]},
    ),
    RunFailed(submission=1, code="worker_lost", message="gone"),
    RunStopped(submission=1),
    RunSucceeded(),
]


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: event.type)
def test_events_survive_json(event):
    assert event_from_json(event.model_dump_json()) == event
    assert json.loads(event.model_dump_json())["type"] == event.type


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


def test_events_of_a_computation_leave_the_state_alone():
    criticised = CriticismFinished(verdict={}, files={})
    for event, state in itertools.product((*EVENTS[2:5], criticised), RunState):
        assert next_state(state, event) is state


def test_keys_of_different_events_differ():
    again = RunQueued(submission=2)
    other = StageFinished(kind="evaluate", digest="1" * 64)
    later = EVENTS[3].model_copy(update={"steps": 80})
    keys = [event.key for event in (*EVENTS, again, other, later)]
    assert len(set(keys)) == len(keys)


def test_an_unknown_event_is_refused():
    with pytest.raises(ValueError, match="run_exploded"):
        event_from_json('{"type": "run_exploded"}')

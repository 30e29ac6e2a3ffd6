import json

import pytest

from adr_service.events import (
    FINISHED,
    CriticismFinished,
    IterationFinished,
    RunFailed,
    RunQueued,
    RunStarted,
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


def test_the_state_is_the_fold_of_the_events():
    queued, started, stage, curve, _, failed, stopped, succeeded = EVENTS
    assert state_after([queued]) == "queued"
    assert state_after([queued, started, stage, curve]) == "running"
    assert state_after([queued, started, failed]) == "failed"
    assert state_after([queued, started, failed, RunQueued(submission=2)]) == "queued"
    assert state_after([queued, started, stopped]) == "cancelled"
    assert state_after([queued, started, succeeded]) == "succeeded"
    assert state_after([]) not in FINISHED


def test_events_of_a_computation_leave_the_state_alone():
    criticised = CriticismFinished(verdict={}, files={})
    for event in (*EVENTS[2:5], criticised):
        for state in ("queued", "running", "succeeded", "failed", "cancelled"):
            assert next_state(state, event) == state


def test_keys_of_different_events_differ():
    again = RunQueued(submission=2)
    other = StageFinished(kind="evaluate", digest="1" * 64)
    later = EVENTS[3].model_copy(update={"steps": 80})
    keys = [event.key for event in (*EVENTS, again, other, later)]
    assert len(set(keys)) == len(keys)


def test_an_unknown_event_is_refused():
    with pytest.raises(ValueError, match="run_exploded"):
        event_from_json('{"type": "run_exploded"}')

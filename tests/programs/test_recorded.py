from dataclasses import replace

import pytest

from adr_service.errors import InvalidInput
from adr_service.programs import run
from adr_service.stages.local import LocalStages
from adr_service.transitions import TransitionDataset, dataset_id
from tests.programs.smoke import smoke
from tests.recordings import recording

RECORDED = recording("arm", 30).to_npz()


def spec(content=RECORDED, method="sysid", **changes):
    target = {"kind": "recorded", "dataset": dataset_id(content), **changes}
    return smoke(method, target=target)


def test_a_recording_gives_one_estimate_and_a_policy_that_nobody_evaluates():
    stages = LocalStages()
    (event,) = [e for e in run(spec(), stages, RECORDED) if e.type == "iteration_finished"]
    assert [stage.kind for stage in stages.executed] == ["infer", "train_policy"]
    assert (event.iteration, event.target_transitions, event.returns) == (1, 30, [])


def test_a_recording_that_is_not_the_named_one_is_refused():
    other = recording("arm", 20).to_npz()
    with pytest.raises(InvalidInput, match=f"given {dataset_id(other)}"):
        list(run(spec(), LocalStages(), other))
    with pytest.raises(InvalidInput, match="given nothing"):
        list(run(spec(), LocalStages()))


def test_more_episodes_than_there_are_cannot_be_asked_for():
    with pytest.raises(InvalidInput, match="has 1 episodes; asked for the first 2"):
        list(run(spec(episodes=2), LocalStages(), RECORDED))


def test_only_the_first_episodes_that_are_asked_for_are_learned_from():
    two = TransitionDataset.concatenate([recording("arm", 30), recording("arm", 20)]).to_npz()
    *_, event = run(spec(two, episodes=1), LocalStages(), two)
    assert (event.target_rollouts, event.target_transitions) == (1, 30)


def test_states_with_two_readings_are_refused_before_anything_is_computed():
    data = recording("arm", 30)
    content = replace(data, next_observations=data.next_observations + 0.1).to_npz()
    stages = LocalStages()
    with pytest.raises(InvalidInput, match="rows 0 and 1 differ"):
        list(run(spec(content, "sysid_smoothed"), stages, content))
    assert not stages.executed
    assert list(run(spec(content), stages, content))


def test_episodes_shorter_than_a_method_replays_are_refused_before_anything_is_computed():
    stages, long = LocalStages(), spec(method={"name": "sysid_smoothed", "steps": 31})
    with pytest.raises(InvalidInput, match="has 31 transitions in a row; sysid_smoothed with ste"):
        list(run(long, stages, RECORDED))
    assert not stages.executed

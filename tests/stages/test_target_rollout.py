"""Recorded trajectories on the simulated target."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.effects.base import Effect, domain_of
from adr_service.errors import InvalidInput
from adr_service.simulation.replay import Replay, check_recorded
from adr_service.stages.base import compute
from adr_service.stages.target_rollout import TargetRollout
from adr_service.tasks.catalogue import get_task, hidden_of
from adr_service.transitions import TransitionDataset
from tests.planted import waving_policy
from tests.stages.examples import UNSTABLE, Speed

ARM = get_task("arm")
STAGE = TargetRollout(
    task="arm",
    variant="vanilla",
    transitions=30,
    iteration=0,
    seed=0,
    policy=waving_policy().to_bytes(),
)


def recorded(stage):
    return TransitionDataset.from_npz(stage.read(compute(stage)).data)


def test_it_is_one_episode_of_the_policy():
    data = recorded(STAGE)
    check_recorded(ARM, data)
    assert data.episode_count == 1
    assert len(data) == 30
    actions = waving_policy().act(data.observations)
    np.testing.assert_allclose(data.actions, actions, atol=1e-6)  # a policy is float32
    np.testing.assert_array_equal(data.observations[1:], data.next_observations[:-1])


def test_without_a_policy_actions_are_random_and_within_bounds():
    data = recorded(replace(STAGE, policy=None, transitions=100))
    assert np.all((ARM.action_low <= data.actions) & (data.actions <= ARM.action_high))
    assert np.all(data.actions.std(axis=0) > 0.3)


def test_the_hidden_truth_replays_it():
    hidden = hidden_of("arm", "vanilla")
    replay = Replay(ARM, hidden.source, recorded(STAGE), 1, 1)
    assert replay.mean_squared_error(hidden.values[None])[0] < 1e-25


@pytest.mark.parametrize("changes", [{"seed": 1}, {"iteration": 1}], ids=str)
def test_another_seed_or_iteration_is_another_episode(changes):
    one, other = recorded(STAGE), recorded(replace(STAGE, **changes))
    assert not np.array_equal(one.observations[0], other.observations[0])


def test_data_end_before_the_step_that_diverges():
    stage = replace(STAGE, **UNSTABLE, policy=None)
    result = stage.read(compute(stage))
    data = TransitionDataset.from_npz(result.data)  # refuses numbers that are not finite
    assert 0 < result.transitions == len(data) < stage.transitions


def test_a_target_that_diverges_at_once_is_an_error():
    brake = Effect("joint_viscous_friction", "joint:bthigh", (-100.0,))  # it drives instead
    stage = replace(STAGE, task="half_cheetah", variant=domain_of("vanilla", [brake]), policy=None)
    with pytest.raises(InvalidInput, match="half_cheetah diverged at its first step"):
        compute(stage)


def test_its_cost_is_its_steps_whether_or_not_the_episode_ends_early():
    cost = STAGE.cost(Speed(100.0))
    assert (cost.seconds, cost.target_transitions) == (0.3, 30)

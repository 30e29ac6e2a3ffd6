"""Returns of single episodes on the simulated target."""

from dataclasses import replace

import pytest

from adr_service.randomness import stream
from adr_service.simulation.target import simulate_rollout
from adr_service.stages.base import compute
from adr_service.stages.target_return import TargetReturn
from adr_service.tasks.catalogue import get_task
from tests.planted import still_policy, waving_policy
from tests.stages.examples import Speed

ARM = get_task("arm")
STAGE = TargetReturn(
    task="arm", variant="vanilla", iteration=0, seed=0, policy=waving_policy().to_bytes()
)


def test_it_is_the_sum_of_the_rewards_of_the_same_episode():
    """The trajectory of the same random stream, rewarded by the task; the arm never ends early."""
    result = STAGE.read(compute(STAGE))
    rng = stream("stage", STAGE.digest)
    data = simulate_rollout(ARM, "vanilla", waving_policy().act, ARM.horizon, rng)
    rewards = ARM.reward(
        ARM.state(data.observations), data.actions, ARM.state(data.next_observations)
    )
    assert result.earned == pytest.approx(rewards.sum(), rel=1e-12)
    assert result.transitions == len(data) == ARM.horizon


def test_an_episode_that_ends_early_has_fewer_transitions():
    """A hopper without power falls."""
    hopper = get_task("hopper")
    stage = replace(STAGE, task="hopper", policy=still_policy(hopper).to_bytes())
    result = stage.read(compute(stage))
    assert 0 < result.transitions < hopper.horizon


def test_its_field_is_stored_under_the_name_return():
    stored = compute(STAGE)
    assert set(stored.values) == {"return", "transitions"}
    assert STAGE.read(stored).earned == stored.values["return"]


def test_its_cost_is_a_whole_episode():
    cost = STAGE.cost(Speed(100.0))
    assert (cost.seconds, cost.target_transitions) == (ARM.horizon / 100, ARM.horizon)
    assert STAGE.stand_in().transitions == ARM.horizon

"""Hopper's reward and ending, by their formulas."""

import numpy as np
import pytest

from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, source_of

HOPPER = get_task("hopper")


def standing():
    return HOPPER.initial(1, np.random.default_rng(0))


def test_the_reward_is_the_speed_plus_one_minus_the_effort():
    before, after = standing(), standing()
    after.qpos[0, 0] = before.qpos[0, 0] + 0.008 * 2.5
    actions = np.array([[0.5, -1.0, 0.2]])
    expected = 2.5 + 1 - 1e-3 * (0.25 + 1 + 0.04)
    assert HOPPER.reward(before, actions, after)[0] == pytest.approx(expected)


@pytest.mark.parametrize("velocity", [99.0, 101.0])
def test_an_episode_ends_beyond_a_hundred_radians_per_second(velocity):
    state = standing()
    state.qvel[0, 4] = velocity
    assert HOPPER.terminated(state)[0] == (velocity > 100)


def test_its_position_along_x_ends_nothing():
    state = standing()
    far = State(state.qpos + np.array([1e4, 0, 0, 0, 0, 0]), state.qvel)
    assert not HOPPER.terminated(far)[0]


def test_only_the_unmodeled_variant_allows_masses_of_a_gram():
    lows = {v: source_of("hopper", v).space.feasible_low.max() for v in ("vanilla", "unmodeled")}
    assert lows == {"vanilla": 0.1, "unmodeled": 0.001}

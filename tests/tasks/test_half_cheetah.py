"""HalfCheetah's reward by its formula; its episodes never end early."""

import numpy as np
import pytest

from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, hidden_of

CHEETAH = get_task("half_cheetah")


def test_the_reward_is_the_speed_minus_the_effort():
    before = CHEETAH.initial(1, np.random.default_rng(0))
    after = State(before.qpos + np.array([0.05 * 3.0, *[0.0] * 8]), before.qvel)
    actions = np.full((1, 6), 0.5)
    assert CHEETAH.reward(before, actions, after)[0] == pytest.approx(3.0 - 0.1 * 6 * 0.25)


def test_no_state_ends_an_episode():
    state = State(1e6 * np.ones((3, 9)), -1e6 * np.ones((3, 9)))
    assert not CHEETAH.terminated(state).any()


def test_its_masses_add_up_to_fourteen_kilograms():
    hidden = hidden_of("half_cheetah", "vanilla")
    masses = [
        v
        for p, v in zip(hidden.source.space.parameters, hidden.values, strict=True)
        if p.unit == "kg"
    ]
    assert sum(masses) == pytest.approx(14.0, rel=1e-12)

"""The arm: its hand, its reward, its limits."""

import mujoco
import numpy as np
import pytest

from adr_service.simulation.model import compiled
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task

ARM = get_task("arm")
AT_REST = np.zeros((1, 2))


def at(shoulder, elbow):
    return State(np.array([[shoulder, elbow]]), AT_REST)


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.4, -1.1), (-2.0, 0.7), (3.0, 3.0)])
def test_the_hand_is_where_mujoco_puts_the_end_of_the_forearm(angles):
    model = compiled(ARM.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = angles
    mujoco.mj_forward(model, data)
    shoulder = data.joint("shoulder").xanchor
    elbow = data.joint("elbow").xanchor
    end = elbow + data.body("fore").xmat.reshape(3, 3) @ [0, 0, -0.5]
    np.testing.assert_allclose(ARM.hand(at(*angles))[0], (end - shoulder)[[0, 2]], atol=1e-12)


def test_the_reward_is_one_at_the_mark_and_falls_with_the_distance():
    """The mark (0.6, 0.4) m by the law of cosines, with links of 0.5 m."""
    reach = np.hypot(0.6, 0.4)
    elbow = np.pi - np.arccos(1 - reach**2 / (2 * 0.5**2))
    shoulder = np.arctan2(0.6, -0.4) - elbow / 2
    np.testing.assert_allclose(ARM.hand(at(shoulder, elbow))[0], [0.6, 0.4], atol=1e-12)
    rewards = [
        ARM.reward(at(0, 0), np.zeros((1, 2)), at(shoulder - turn, elbow))[0]
        for turn in (0.0, 0.1, 0.3, 0.9)
    ]
    assert rewards[0] == pytest.approx(1.0)
    assert np.all(np.diff(rewards) < 0)
    assert rewards[-1] >= 0


def test_an_episode_ends_when_a_joint_turns_to_three_and_a_half_radians():
    assert not ARM.terminated(at(3.49, -3.49))[0]
    assert ARM.terminated(at(0.0, 3.5))[0]
    assert ARM.terminated(at(-3.5, 0.0))[0]

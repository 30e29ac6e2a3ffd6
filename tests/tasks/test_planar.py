"""Laws of the robots that run along x in the vertical plane."""

import numpy as np
import pytest

from adr_service.tasks import planar
from adr_service.tasks.base import State

RNG = np.random.default_rng(0)
STATE = State(RNG.normal(size=(4, 6)), RNG.normal(size=(4, 6)))


def test_the_state_of_an_observation_is_the_state_at_x_zero():
    state = planar.at_origin(planar.observe(STATE))
    assert not state.qpos[:, 0].any()
    np.testing.assert_array_equal(state.qpos[:, 1:], STATE.qpos[:, 1:])
    np.testing.assert_array_equal(state.qvel, STATE.qvel)


def test_x_is_not_observed():
    shifted = State(STATE.qpos + np.array([5.0, 0, 0, 0, 0, 0]), STATE.qvel)
    np.testing.assert_array_equal(planar.observe(shifted), planar.observe(STATE))


def test_there_is_a_column_for_every_observed_value():
    columns = planar.columns(("thigh", "leg", "foot"))
    assert len(columns) == planar.observe(STATE).shape[1] == 11
    assert columns[:2] == ("z [m]", "torso_angle [rad]")
    assert columns[-1] == "foot_velocity [rad/s]"


def test_the_speed_is_the_distance_travelled_over_time():
    later = State(STATE.qpos + np.array([0.3, 9, 9, 9, 9, 9]), STATE.qvel)
    assert planar.speed(STATE, later, 0.1) == pytest.approx([3.0] * 4)

"""Humanoid: its quaternion, its reward, and the columns that sensors do not measure."""

import numpy as np
import pytest

from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task

HUMANOID = get_task("humanoid")
COM_X = (10 + 6 + 6) * 14 + 23  # after inertias, velocities, contacts and actuations


def test_initial_orientations_are_unit_quaternions():
    quaternions = HUMANOID.initial(20, np.random.default_rng(0)).qpos[:, 3:7]
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, rtol=1e-12)


def test_a_noisy_orientation_is_normalised_and_points_the_same_way():
    observations = np.zeros((1, 45))
    observations[0, 1:5] = 1.1, 0.2, -0.1, 0.05
    quaternion = HUMANOID.state(observations).qpos[0, 3:7]
    assert np.linalg.norm(quaternion) == pytest.approx(1.0)
    np.testing.assert_allclose(quaternion / quaternion[0], observations[0, 1:5] / 1.1)


def test_the_reward_is_the_speed_of_the_centre_of_mass_plus_five_minus_the_effort():
    derived = np.zeros((1, COM_X + 1))
    before = State(np.zeros((1, 24)), np.zeros((1, 23)), derived)
    moved = derived.copy()
    moved[0, COM_X] = 0.015 * 2.0
    after = State(np.zeros((1, 24)), np.zeros((1, 23)), moved)
    actions = np.full((1, 17), 0.2)
    expected = 1.25 * 2.0 + 5.0 - 0.1 * 17 * 0.04
    assert HUMANOID.reward(before, actions, after)[0] == pytest.approx(expected)


def test_sensors_measure_positions_and_velocities_alone():
    measured = HUMANOID.columns[: HUMANOID.measured]
    assert measured[0] == "z [m]"
    assert measured[-1] == "left_elbow_velocity [rad/s]"
    assert "world_inertia_xx" in HUMANOID.columns[HUMANOID.measured]

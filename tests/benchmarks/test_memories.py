"""Forces with a memory, which benchmarks hide."""

import mujoco
import numpy as np
import pytest

from benchmarks.memories import Bristles, Heat

MODEL = mujoco.MjModel.from_xml_string(
    """
    <mujoco>
      <worldbody>
        <body><joint name="hinge"/><geom size=".1"/></body>
      </worldbody>
      <actuator><motor joint="hinge"/></actuator>
    </mujoco>
    """
)


def forces(memory, times, velocity=0.0, command=0.0):
    """Its forces at these times [s] of an episode with a constant velocity and command."""
    data = mujoco.MjData(MODEL)
    found = []
    for seconds in times:
        data.time, data.qvel[:], data.ctrl[:] = seconds, velocity, command
        found.append(memory.at(data, seconds, 1.0))
    return np.array(found)


def test_bristles_bend_over_a_distance_whatever_the_velocity():
    times = np.linspace(0, 1, 11)
    for velocity in (0.2, 2.0):
        gone = velocity * times
        expected = -3.0 * (1 - np.exp(-gone / 0.1))
        assert forces(Bristles(0, 3.0, 0.1), times, velocity) == pytest.approx(expected)


def test_bristles_push_back_where_the_joint_turns_round():
    memory = Bristles(0, 3.0, 0.1)
    assert forces(memory, [0.0, 1.0], velocity=2.0)[-1] == pytest.approx(-3.0)
    assert forces(memory, [1.01], velocity=-0.1)[0] < -2.5
    assert forces(memory, [2.0], velocity=-2.0)[0] == pytest.approx(3.0)


def test_a_drive_loses_torque_as_it_warms_up_and_is_cold_in_the_next_episode():
    memory = Heat(0, 3.0, 0.5)
    expected = [0.0, -3.0 * (1 - np.exp(-2)) * 0.5**3]
    for _ in range(2):
        assert forces(memory, [0.0, 1.0], command=0.5) == pytest.approx(expected)

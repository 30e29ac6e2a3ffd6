"""Signs and scales of a map, checked by what commands do to the robot."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.criticism.measurements import Measurement
from adr_service.logs.agreement import agreements

ARM = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 1 0" damping="0.1" FRICTION/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="1" contype="0"/>
      <body pos="0.4 0 0">
        <joint name="elbow" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5" contype="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="shoulder" gear="8"/>
    <motor name="second" joint="elbow" gear="3"/>
  </actuator>
</mujoco>
"""
PLAIN = ARM.replace("FRICTION", "")


@pytest.fixture(scope="module")
def measured():
    return moved(PLAIN)


def test_fewer_than_three_episodes_say_nothing(measured):
    model = mujoco.MjModel.from_xml_string(PLAIN)
    assert list(agreements(measured.episodes(range(2)), model)) == []
    assert list(agreements(measured.episodes(range(3)), model))


def moved(xml):
    """Ten episodes of a robot that random commands move, seen by encoders with steps."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    rows = []
    for episode in range(10):
        mujoco.mj_resetData(model, data)
        command = np.zeros(2)
        for _ in range(100):
            command = 0.9 * command + 0.4 * rng.standard_normal(2)
            position = np.round(data.qpos / 2e-4) * 2e-4
            rows.append([data.time, episode, *position, *data.qvel, *command])
            data.ctrl[:] = command
            mujoco.mj_step(model, data, nstep=5)
    table = np.array(rows)
    return Measurement(
        time=table[:, 0],
        episode=table[:, 1].astype(int),
        qpos=table[:, 2:4],
        qvel=table[:, 4:6],
        ctrl=table[:, 6:8],
    )


def warnings(data, xml=PLAIN):
    return [each.warning() for each in agreements(data, mujoco.MjModel.from_xml_string(xml))]


def test_a_right_map_has_slopes_of_one_and_no_warning(measured):
    model = mujoco.MjModel.from_xml_string(PLAIN)
    found = list(agreements(measured, model))
    assert [each.joint for each in found] == ["shoulder", "elbow"]
    for each in found:
        assert each.slope == pytest.approx(1, abs=max(3 * each.error, 0.03))
    assert warnings(measured) == ["", ""]


@pytest.mark.parametrize("command", [0.3, 0.37])
def test_a_command_that_never_changes_says_nothing(measured, command):
    """The mean of many equal numbers is another one, by rounding."""
    ctrl = np.column_stack([np.full(len(measured.time), command), measured.ctrl[:, 1]])
    model = mujoco.MjModel.from_xml_string(PLAIN)
    assert [each.joint for each in agreements(replace(measured, ctrl=ctrl), model)] == ["elbow"]


@pytest.mark.parametrize("mirrored", ["qpos", "ctrl"])
def test_a_mirrored_encoder_or_motor_is_pointed_out(measured, mirrored):
    turned = getattr(measured, mirrored) * np.array([1.0, -1.0])
    first, second = warnings(replace(measured, **{mirrored: turned}))
    assert first == ""
    assert "elbow accelerates against the commands to second" in second
    assert "actuators.second.scale and joints.elbow.scale" in second


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_a_forgotten_gain_is_pointed_out(measured, factor):
    scaled = replace(measured, ctrl=measured.ctrl * np.array([factor, 1.0]))
    first, second = warnings(scaled)
    assert f"shoulder accelerates {1 / factor:.2g} times as much" in first
    assert second == ""


def test_friction_of_a_usual_size_is_no_reason_to_warn():
    rubbing = ARM.replace("FRICTION", 'frictionloss="0.8"')  # a tenth of the drive's largest
    assert warnings(moved(rubbing)) == ["", ""]


def test_a_robot_that_touches_something_is_not_judged(measured):
    floor = PLAIN.replace(' contype="0"', "").replace(
        "<worldbody>", '<worldbody><geom type="plane" size="1 1 1" pos="0 0 0.02"/>'
    )
    assert warnings(measured, floor) == []

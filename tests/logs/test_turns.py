"""Readings and set-points that begin again at the end of a turn."""

import mujoco
import numpy as np
import pytest

from adr_service.logs.conversion import convert
from adr_service.logs.mapping import LogMap
from tests.logs.conftest import MAP, XML, log, motion

SERVO = XML.replace(
    '<motor name="motor" joint="shoulder" gear="5"', '<position name="motor" joint="shoulder"'
).replace('ctrlrange="-1 1"', 'ctrlrange="-9 9"')
WRAPS = MAP.replace('position = "q1"', 'position = "q1"\nunit = "deg"\nwrap = 360.0').replace(
    'velocity = "dq1"', 'velocity_unit = "rad/s"\nvelocity = "dq1"'
)


def in_degrees(radians):
    return np.degrees(radians) % 360


def test_a_joint_goes_on_at_its_speed_across_a_gap(robot, even):
    """The pauses are longer than half a turn takes."""
    fast = {"q1": 6 * np.sin(1.1 * even["time"]), "dq1": 6.6 * np.cos(1.1 * even["time"])}
    time = even["time"]
    kept = ((time < 5.3) | (time > 6.2)) & ((time < 11.0) | (time > 11.9))
    logged = {**even, **fast, "q1": in_degrees(fast["q1"])}
    converted = convert(
        [log({name: values[kept] for name, values in logged.items()})],
        LogMap.from_toml(WRAPS),
        robot,
    )
    data = converted.measurement
    away = data.qpos[:, 0] - 6 * np.sin(1.1 * data.time)
    np.testing.assert_allclose(away, away[0], atol=1e-6)
    (warning,) = [each for each in converted.warnings if "wrap" in each]
    assert warning.startswith("shoulder's readings wrap, and have 2 gaps, of 0.908 s at most")


def test_recordings_without_gaps_are_not_warned_of_turns(robot, even):
    logged = {**even, "q1": in_degrees(even["q1"])}
    warnings = convert([log(logged)], LogMap.from_toml(WRAPS), robot).warnings
    assert not [each for each in warnings if "wrap" in each]


@pytest.mark.parametrize("wraps", [True, False])
def test_set_points_are_put_next_to_their_joint(even, wraps):
    """The joint swings about the end of a turn, and is logged one turn away from the model's."""
    wanted = np.degrees(even["q1"] + 0.1) + 360
    logged = {**even, "q1": np.degrees(even["q1"]) + 360, "u": wanted % 360 if wraps else wanted}
    given = WRAPS.replace('command = "u"', 'command = "u"\nunit = "deg"\nwrap = 360.0')
    model = mujoco.MjModel.from_xml_string(SERVO)
    data = convert([log(logged)], LogMap.from_toml(given), model).measurement
    np.testing.assert_allclose(data.qpos[:, 0], motion(data.time)["q1"], atol=1e-9)
    np.testing.assert_allclose(data.ctrl[:, 0], data.qpos[:, 0] + 0.1, atol=0.01)


def test_a_lone_reading_beside_a_gap_tells_no_speed(robot):
    """A joint turns evenly, and one reading stands alone in a pause that is longer than a turn."""
    time = np.arange(0, 20, 0.004)
    kept = (time < 10.0) | (np.abs(time - 11.2) < 1e-6) | (time > 12.4)
    even = {**motion(time), "q1": 6 * time - 60, "dq1": np.full(len(time), 6.0)}
    logged = {name: values[kept] for name, values in {**even, "q1": in_degrees(even["q1"])}.items()}
    logged["dq1"] = logged["dq1"] + 1e-6 * np.arange(len(logged["dq1"]))
    data = convert([log(logged)], LogMap.from_toml(WRAPS), robot).measurement
    away = data.qpos[:, 0] - 6 * data.time
    np.testing.assert_allclose(away, away[0], atol=1e-6)

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


GEARED = WRAPS.replace('unit = "deg"', 'unit = "deg"\nscale = 0.1\nzero = 0.0').replace(
    'velocity = "dq1"', 'velocity = "dq1"\nvelocity_scale = 1.0'
)


def warned(warnings, start):
    return [each for each in warnings if each.startswith(start)]


def test_a_geared_encoder_keeps_the_branch_of_its_readings_and_its_zero(robot, even):
    """The encoder turns ten times as fast as the joint, which stands at 1.2 turns of it."""
    stands = np.radians(36 * 1.2)
    logged, second = (
        {**each, "q1": in_degrees(10 * (each["q1"] + stands))}
        for each in (even, motion(even["time"] + 20 * np.pi))
    )
    for recordings in ([log(logged)], [log(logged), log(second, "second.csv")]):
        for zero, shift in (("0.0", 0.2 * 36), ("-360.0", 1.2 * 36)):
            given = LogMap.from_toml(GEARED.replace("zero = 0.0", f"zero = {zero}"))
            converted = convert(recordings, given, robot)
            data = converted.measurement
            for first, last in data.spans():
                truth = motion(data.time[first:last])["q1"] + np.radians(shift)
                np.testing.assert_allclose(data.qpos[first:last, 0], truth, atol=1e-9)
            (warning,) = warned(converted.warnings, "shoulder's readings wrap every 0.628 rad")
            assert "shift zero by multiples of 360" in warning
            assert ("convert these on their own" in warning) == (len(recordings) > 1)


def test_readings_that_wrap_at_a_slide_keep_their_branch(robot, even):
    """A motor whose turn moves the slider by 10 mm, around .1 m."""
    logged = {**even, "q2": ((even["q2"] + 0.1) * 1000) % 10}
    given = MAP.replace('"q2"', '"q2"\nunit = "mm"\nwrap = 10.0\nvelocity_unit = "m/s"')
    converted = convert([log(logged)], LogMap.from_toml(given), robot)
    data = converted.measurement
    away = data.qpos[:, 1] - motion(data.time)["q2"]
    np.testing.assert_allclose(away, -0.1, atol=1e-9)  # the first reading is 0 of 10 mm
    (warning,) = warned(converted.warnings, "slider's readings wrap every 0.01 m, so nothing")
    assert "shift zero by multiples of 10" in warning


@pytest.mark.parametrize("turns", [1, 3])
def test_readings_that_wrap_after_whole_turns_of_a_hinge_are_put_next_to_its_middle(
    robot, even, turns
):
    logged = {**even, "q1": in_degrees((even["q1"] - 0.5) / turns)}
    given = LogMap.from_toml(GEARED.replace("scale = 0.1", f"scale = {turns}.0"))
    converted = convert([log(logged)], given, robot)
    data = converted.measurement
    np.testing.assert_allclose(data.qpos[:, 0], motion(data.time)["q1"] - 0.5, atol=1e-9)
    assert not warned(converted.warnings, "shoulder's readings wrap")


@pytest.mark.parametrize("sides", [(-1, 1), (1, -1)])
@pytest.mark.parametrize("most", [175, 180.0002])
def test_recordings_at_both_ends_of_a_joints_range_stay_within_it(even, sides, most):
    """The second one was put next to the first, beyond the joint's limit."""
    limits = f'range="-{most} {most}" limited="true"'
    limited = XML.replace('name="shoulder"', f'name="shoulder" {limits}')
    logs = []
    for number, side in enumerate(sides):
        swing = side * np.radians(140) + 0.4 * even["q1"]
        logs.append(log({**even, "q1": in_degrees(swing), "dq1": 0.4 * even["dq1"]}, f"{number}"))
    given, model = LogMap.from_toml(WRAPS), mujoco.MjModel.from_xml_string(limited)
    data = convert(logs, given, model).measurement
    middles = [np.median(data.qpos[first:last, 0]) for first, last in data.spans()]
    assert np.sign(middles).tolist() == np.repeat(sides, len(middles) // 2).tolist()
    assert np.abs(data.qpos[:, 0]).max() < np.radians(175)


@pytest.mark.parametrize(("speed", "is_warned"), [(0.3, False), (0.4, True)])
def test_an_encoder_that_turns_nearly_half_between_readings_is_pointed_out(
    robot, even, speed, is_warned
):
    """`speed`: most turns of the encoder from one reading to the next."""
    gear = speed * 360 / np.degrees(3 * 0.004)
    logged = {**even, "q1": in_degrees(gear * even["q1"])}
    given = LogMap.from_toml(GEARED.replace("scale = 0.1", f"scale = {1 / gear}"))
    found = warned(convert([log(logged)], given, robot).warnings, "shoulder moves by up to 0.4 of")
    assert bool(found) == is_warned


def test_set_points_that_jump_by_a_turn_are_pointed_out(even):
    """The joint's readings go on, and its set-points begin again."""
    joint = np.degrees(4 * even["q1"])
    logged = {**even, "q1": joint, "dq1": 4 * even["dq1"], "u": joint % 360}
    given = WRAPS.replace("\nwrap = 360.0", "").replace('"u"', '"u"\nunit = "deg"')
    model = mujoco.MjModel.from_xml_string(SERVO)
    (warning,) = warned(
        convert([log(logged)], LogMap.from_toml(given), model).warnings, "column 'u'"
    )
    assert "give actuators.motor.wrap, and joints.shoulder.wrap as well" in warning
    both = given.replace('"u"\n', '"u"\nwrap = 360.0\n').replace('"q1"\n', '"q1"\nwrap = 360.0\n')
    converted = convert([log(logged)], LogMap.from_toml(both), model)
    assert not warned(converted.warnings, "column 'u'")
    data = converted.measurement
    np.testing.assert_allclose(data.ctrl[:, 0], data.qpos[:, 0], atol=0.1)


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_readings_that_wrap_without_a_wrap_in_the_map_are_pointed_out(robot, even, step):
    """Fine readings, and those of an encoder that repeats its steps [deg]."""
    enough = MAP.replace('velocity = "dq1"', "").replace(
        'position = "q1"', 'position = "q1"\nunit = "deg"\nscale = 0.1'
    )
    slow = np.arange(0, 60, 0.004)
    columns = {**motion(slow), "q1": in_degrees(10 * np.sin(0.4 * slow))}
    if step:
        columns["q1"] = step * np.floor(columns["q1"] / step)
    converted = convert([log(columns)], LogMap.from_toml(enough), robot)
    (warning,) = warned(converted.warnings, "column 'q1' jumps over its whole range at ")
    assert "give joints.shoulder.wrap" in warning
    reach = float(warning.rsplit("range over ", 1)[1].rstrip(")"))
    assert reach == pytest.approx(360, abs=1)
    first = float(warning.split(" at ")[1].split(" s")[0])
    turns = np.floor(np.degrees(10 * np.sin(0.4 * slow)) / 360)
    assert first == pytest.approx(slow[np.flatnonzero(np.diff(turns))[0] + 1], abs=0.005)


def test_a_single_outlier_is_no_turn(robot, even, given):
    spiked = {**even, "q1": np.where(even["time"] == even["time"][2000], 30.0, even["q1"])}
    warnings = convert([log(spiked)], given, robot).warnings
    assert not warned(warnings, "column 'q1' jumps")
    (warning,) = warned(warnings, "column 'q1' is far off the readings before and after")
    assert f"agree, 1 times, first at {even['time'][2000]:.6g} s" in warning


@pytest.mark.parametrize("kind", ["noisy", "coarse", "mostly at rest"])
def test_noise_and_steps_of_a_coarse_sensor_are_no_outliers(robot, even, given, kind):
    noise = np.random.default_rng(0).standard_normal(len(even["time"]))
    columns = {
        "noisy": {"dq1": even["dq1"] + 0.5 * noise},
        "coarse": {"dq1": np.round(even["dq1"] + 0.3 * noise)},
        "mostly at rest": {"q2": np.where(even["time"] > 18, 0.02, 1e-3 * noise), "dq2": noise},
    }[kind]
    converted = convert([log({**even, **columns})], given, robot)
    assert not [each for each in converted.warnings if "far off the readings" in each]


def test_set_points_behind_a_gear_are_put_next_to_the_turns_of_their_drive(even):
    """The joint swings by four radians, and its drive by eight."""
    joint = 4 * even["q1"]
    logged = {**even, "q1": in_degrees(joint), "dq1": 4 * even["dq1"], "u": in_degrees(2 * joint)}
    given = WRAPS.replace('command = "u"', 'command = "u"\nunit = "deg"\nwrap = 360.0')
    model = mujoco.MjModel.from_xml_string(SERVO.replace('name="motor"', 'name="motor" gear="2"'))
    data = convert([log(logged)], LogMap.from_toml(given), model).measurement
    np.testing.assert_allclose(data.ctrl[:, 0], 2 * data.qpos[:, 0], atol=0.2)

"""A draft of the map: what it knows, what it guesses, and what it leaves open."""

import mujoco
import numpy as np
import pytest

from adr_service.logs.drafting import draft
from adr_service.logs.mapping import LogMap
from tests.logs.conftest import log, motion

ONE = """<mujoco><worldbody><body><joint name="hip"/><geom size="1"/></body></worldbody>
<actuator><motor name="drive" joint="hip"/></actuator></mujoco>"""


def test_a_draft_finds_columns_by_word_and_number(robot):
    columns = motion(np.arange(5.0))
    renamed = {"stamp_ms": columns["time"], "q1_deg": columns["q1"], "q2_mm": columns["q2"]}
    renamed |= {"dq1_deg": columns["dq1"], "current": columns["u"], "x": columns["u"]}
    text = draft([log(renamed)], robot)
    found = LogMap.from_toml(text)
    assert (found.time.column, found.time.unit) == ("stamp_ms", "ms")
    assert (found.joints["shoulder"].position, found.joints["shoulder"].unit) == ("q1_deg", "deg")
    assert (found.joints["slider"].position, found.joints["slider"].unit) == ("q2_mm", "mm")
    assert found.joints["slider"].velocity is None  # there are two joints and one column
    assert text.count("guessed by the order") == 2
    assert found.actuators["motor"].command == "current"
    assert "#   x: 5, " in text


def test_a_draft_finds_columns_by_the_joint_and_marks_what_it_does_not_know(robot):
    columns = {"/state.position.slider": np.zeros(3), "/state.position.wheel": np.zeros(3)}
    found = LogMap.from_toml(draft([log({"time": np.arange(3.0), **columns})], robot))
    assert found.joints["slider"].position == "/state.position.slider"
    assert found.actuators["motor"].command == "?"


@pytest.mark.parametrize(
    ("position", "command", "unit"),
    [
        ("q_deg", "cmd", "deg"),
        ("q", "cmd_deg", "deg"),
        ("wide_q", "cmd", "deg"),
        ("q", "cmd", "rad"),
    ],
)
def test_a_set_point_gets_the_unit_of_its_column_or_its_joint(position, command, unit):
    """It became radians, 57 times too large."""
    columns = {"time": np.arange(3.0), command: np.zeros(3)}
    columns[position] = np.array([-40.0, 0.0, 90.0]) * ("wide" in position)
    servo = mujoco.MjModel.from_xml_string(ONE.replace("<motor", "<position"))
    text = draft([log(columns)], servo)
    found = LogMap.from_toml(text)
    found.check(servo)
    assert (found.actuators["drive"].command, found.actuators["drive"].unit) == (command, unit)


def test_a_set_point_of_a_geared_servo_is_scaled_by_its_gear():
    """MuJoCo compares its command with gear × position."""
    servo = mujoco.MjModel.from_xml_string(ONE.replace("<motor", '<position gear="50"'))
    text = draft([log({"time": np.arange(3.0), "cmd": np.zeros(3), "q": np.zeros(3)})], servo)
    assert LogMap.from_toml(text).actuators["drive"].scale == 50


@pytest.mark.parametrize(
    ("kind", "columns", "command", "is_marked"),
    [
        ("position", ("effort_hip",), "?", False),
        ("motor", ("effort_hip",), "effort_hip", True),
        ("motor", ("effort_hip", "cmd_hip"), "cmd_hip", False),
        ("motor", ("torque_cmd_hip",), "torque_cmd_hip", False),
        ("position", ("current_hip", "cmd_hip"), "cmd_hip", False),
    ],
)
def test_an_effort_is_a_command_of_a_motor_alone_and_is_marked(kind, columns, command, is_marked):
    names = ("time", "q_hip", *columns)
    model = mujoco.MjModel.from_xml_string(ONE.replace("<motor", f"<{kind}"))
    text = draft([log({name: np.zeros(3) for name in names})], model)
    assert LogMap.from_toml(text).actuators["drive"].command == command
    assert ("may be measured" in text) == is_marked


def test_a_column_that_is_called_as_a_drive_alone_is_its_command(robot):
    columns = {name: np.zeros(3) for name in ("time", "q1", "Slider", "Motor")}
    found = LogMap.from_toml(draft([log(columns)], robot))
    assert found.actuators["motor"].command == "Motor"
    assert found.joints["slider"].position == "Slider"


def test_a_column_with_a_word_goes_before_one_with_the_name_alone(robot):
    names = ("time", "shoulder", "slider", "pos_shoulder", "pos_slider", "Motor", "u")
    found = LogMap.from_toml(draft([log({name: np.zeros(3) for name in names})], robot))
    assert found.joints["shoulder"].position == "pos_shoulder"
    assert found.joints["slider"].position == "pos_slider"
    assert found.actuators["motor"].command == "u"


def test_a_column_that_is_called_as_a_joint_and_a_drive_may_be_either():
    xml = """<mujoco><worldbody><body><joint name="hip"/><geom size="1"/></body></worldbody>
    <actuator><motor name="hip" joint="hip"/></actuator></mujoco>"""
    columns = {"time": np.arange(3.0), "hip": np.zeros(3)}
    found = LogMap.from_toml(draft([log(columns)], mujoco.MjModel.from_xml_string(xml)))
    assert (found.joints["hip"].position, found.actuators["hip"].command) == ("?", "?")


def test_names_that_toml_cannot_bear_are_quoted():
    xml = """<mujoco><worldbody><body><joint name="left arm/1"/><geom size="1"/></body></worldbody>
    </mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    text = draft([log({"time": np.arange(3.0), "q": np.zeros(3)})], model)
    assert LogMap.from_toml(text).joints["left arm/1"].position == "q"


def test_columns_with_odd_letters_give_a_draft_that_can_be_read(robot):
    columns = {"time": np.arange(3.0), "shoulder_pos \U0001f600": np.zeros(3), "a\nb": np.zeros(3)}
    text = draft([log(columns)], robot)
    assert LogMap.from_toml(text).joints["shoulder"].position == "shoulder_pos \U0001f600"


def test_a_draft_reads_abbreviations_in_any_order(robot):
    columns = {"time": np.arange(3.0), "pos_sl": np.zeros(3), "pos_sh": np.zeros(3)}
    text = draft([log(columns)], robot)
    found = LogMap.from_toml(text)
    assert found.joints["shoulder"].position == "pos_sh"
    assert found.joints["slider"].position == "pos_sl"
    assert text.count("guessed by its name") == 2


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        (("pos_left_hip", "pos_lk"), ("pos_left_hip", "?")),  # of one joint, and of nobody knows
        (("pos_left", "vel_left"), ("?", "?")),  # it may be either
        (("q_hip", "q_knee"), ("q_hip", "q_knee")),
    ],
)
def test_a_column_is_never_given_to_two_joints(columns, expected):
    xml = """<mujoco><worldbody><body><joint name="left_hip"/><geom size="1"/><body>
    <joint name="left_knee"/><geom size="1"/></body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    found = LogMap.from_toml(
        draft([log({"time": np.arange(3.0), **{name: np.zeros(3) for name in columns}})], model)
    )
    assert (found.joints["left_hip"].position, found.joints["left_knee"].position) == expected


@pytest.mark.parametrize(
    ("spacing", "unit"),
    [
        *((0.01, "s"), (10.0, "ms"), (1e4, "us"), (1e7, "ns")),
        *((0.001, "s"), (1.0, "ms"), (0.5, "ms"), (1e3, "us"), (1e6, "ns"), (0.1, "s")),
    ],
)
def test_the_unit_of_stamps_without_one_is_guessed_by_their_pace(robot, spacing, unit):
    text = draft([log({"stamp": spacing * np.arange(5.0), "q": np.zeros(5)})], robot)
    assert f'unit = "{unit}"  # guessed: s, ms, us, ns' in text


def test_a_column_of_times_is_drafted_before_seconds_and_nanoseconds_of_something_else(robot):
    seconds = 2e-3 * np.arange(5)
    columns = {"time": seconds, "timeout.sec": np.zeros(5), "timeout.nanosec": 1e9 * seconds}
    found = LogMap.from_toml(draft([log({**columns, "q": np.zeros(5)})], robot)).time
    assert (found.column, found.nanoseconds) == ("time", None)


def test_seconds_and_nanoseconds_of_the_stamp_are_drafted_before_other_pairs(robot):
    names = ("battery_age.nanosec", "battery_age.sec", "header.stamp.nanosec", "header.stamp.sec")
    columns = {name: np.arange(5.0) for name in names}
    found = LogMap.from_toml(draft([log({**columns, "q": np.zeros(5)})], robot)).time
    assert (found.column, found.nanoseconds) == ("header.stamp.sec", "header.stamp.nanosec")


def test_a_draft_adds_nanoseconds_to_whole_seconds(robot):
    columns = {"header.stamp.sec": np.zeros(5), "header.stamp.nanosec": 2e6 * np.arange(5)}
    found = LogMap.from_toml(draft([log({**columns, "q": np.zeros(5)})], robot)).time
    assert (found.column, found.unit) == ("header.stamp.sec", "s")
    assert found.nanoseconds == "header.stamp.nanosec"


def test_angles_beyond_many_turns_are_guessed_to_be_degrees(robot):
    columns = {"time": np.arange(3.0), "shoulder_pos": np.array([-40.0, 0.0, 90.0])}
    assert LogMap.from_toml(draft([log(columns)], robot)).joints["shoulder"].unit == "deg"

"""Logs of a known motion as measurements: each row is compared with the motion at its time."""

import re

import mujoco
import numpy as np
import pytest

from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput
from adr_service.logs.base import Log, Stream
from adr_service.logs.conversion import convert
from adr_service.logs.mapping import LogMap
from tests.logs.conftest import MAP, XML, log, motion
from tests.packages import ROOT


def changed(*pairs):
    """The map with other settings."""
    text = MAP
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return LogMap.from_toml(text)


def assert_is_the_motion(data, tolerance):
    truth = motion(data.time)
    for number, name in enumerate(("1", "2")):
        np.testing.assert_allclose(data.qpos[:, number], truth[f"q{name}"], atol=tolerance)
        np.testing.assert_allclose(data.qvel[:, number], truth[f"dq{name}"], atol=10 * tolerance)


def test_an_even_log_keeps_its_readings(robot, even, given):
    converted = convert([log(even)], given, robot)
    data = converted.measurement
    assert converted.period == pytest.approx(0.004)
    assert [last - first for first, last in data.spans()] == [250] * 20
    assert_is_the_motion(data, 1e-9)
    assert data.qvel_std is None


def test_uneven_stamps_are_resampled(robot, given):
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.0017, 0.0031, 5000))
    converted = convert([log(motion(time))], given, robot)
    assert converted.period == 0.002
    assert_is_the_motion(converted.measurement, 1e-7)
    assert converted.records[0].columns[0].way == "spline"


def test_the_scatter_of_readings_is_their_noise(robot, given):
    """At even and uneven times, and much above the error of a spline."""
    rng = np.random.default_rng(0)
    for time in (np.arange(0, 20, 0.004), np.cumsum(rng.uniform(0.002, 0.006, 5000))):
        columns = motion(time)
        columns["q1"] = columns["q1"] + 2e-4 * rng.normal(size=len(time))
        converted = convert([log(columns)], given, robot)
        noisy, clean, *_ = converted.records[0].columns
        assert noisy.scatter == pytest.approx(2e-4, rel=0.1)
        assert clean.quantity == "slider.position"
        assert clean.scatter < 1e-8
        np.testing.assert_array_equal(converted.noise[:2], [noisy.scatter, clean.scatter])


def test_resampling_at_jittered_times_does_not_multiply_noise(robot, given):
    """Readings that nearly coincide would make a spline swing."""
    rng = np.random.default_rng(3)
    time = np.sort(0.002 * (np.arange(10_000) + 0.3 * rng.normal(size=10_000)))
    columns = motion(time)
    columns["q1"] = columns["q1"] + 1e-4 * rng.normal(size=len(time))
    data = convert([log(columns)], given, robot).measurement
    error = data.qpos[:, 0] - motion(data.time)["q1"]
    assert error.std() < 2e-4
    assert np.abs(error).max() < 2e-3


def test_the_scatter_of_a_coarse_encoder_is_that_of_its_steps(robot, even, given):
    step = 2 * np.pi / 1024
    coarse = {**even, "q1": step * np.round(even["q1"] / step)}
    converted = convert([log(coarse)], given, robot)
    assert converted.records[0].columns[0].scatter == pytest.approx(step / np.sqrt(12))


def test_a_velocity_has_a_scale_of_its_own(robot, even):
    counts = {**even, "q1": even["q1"] * 4096 / (2 * np.pi), "dq1": even["dq1"] * 60 / (2 * np.pi)}
    given = changed(
        ('position = "q1"', 'position = "q1"\nunit = "rev"\nscale = 0.000244140625'),
        ('velocity = "dq1"', 'velocity = "dq1"\nvelocity_unit = "rpm"\nvelocity_scale = 1.0'),
    )
    assert_is_the_motion(convert([log(counts)], given, robot).measurement, 1e-9)


def test_a_command_between_readings_may_move_in_a_line(robot, even):
    """The mean of a ramp over a step of the model is its value in the middle of the step."""
    given = changed(('command = "u"', 'command = "u"\nbetween = "line"'))
    ramp = {**even, "u": 0.05 * even["time"]}
    data = convert([log(ramp)], given, robot).measurement
    times = data.time[:, None] + np.array([0.001, 0.003])
    np.testing.assert_allclose(data.ctrl_within[:-1, :, 0], 0.05 * times[:-1], atol=1e-9)


def test_a_joint_may_rest_in_one_of_several_recordings(robot, even, given):
    still = {**even, "q2": np.full(len(even["time"]), 0.05), "dq2": np.zeros(len(even["time"]))}
    data = convert([log(even), log(still, "second.csv")], given, robot).measurement
    assert len(data.spans()) == 40


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("seconds = 0.03", r"rows.seconds is 0.03; an episode needs 10 rows"),
        ("period = 0.002", r"rows 0.002 s apart are more than the readings of 'q1', 0.004 s apart"),
    ],
)
def test_rows_that_the_log_cannot_fill_are_refused(robot, even, setting, message):
    given = changed(('command = "u"', f'command = "u"\n[rows]\n{setting}'))
    with pytest.raises(InvalidInput, match=message):
        convert([log(even)], given, robot)


def test_streams_whose_clocks_differ_are_refused(robot, even, given):
    states = Stream({n: even[n] for n in ("q1", "dq1", "q2", "dq2")}, even["time"])
    commands = Stream({"u": even["u"]}, even["time"] + 1.7e9)
    with pytest.raises(InvalidInput, match=r"'u' begins at .* after 'q1' has ended"):
        convert([Log("run.mcap", (states, commands))], given, robot)


def test_units_signs_zeros_and_turns_are_converted(robot, even):
    encoder = np.degrees(-even["q1"]) + 170
    log_of = {**even, "q1": (encoder + 180) % 360 - 180, "dq1": -even["dq1"] * 60 / (2 * np.pi)}
    log_of |= {"q2": 1000 * even["q2"], "time": 1000 * even["time"], "u": even["u"] / 0.4 + 1}
    extra = 'unit = "deg"\nscale = -1.0\nzero = 170.0\nwrap = 360.0\nvelocity_unit = "rpm"'
    given = changed(
        ('position = "q1"', f'position = "q1"\n{extra}'),
        ('position = "q2"', 'position = "q2"\nunit = "mm"\nvelocity_unit = "m/s"'),
        ('command = "u"', 'command = "u"\nscale = 0.4\nzero = 1.0\n[time]\nunit = "ms"'),
    )
    data = convert([log(log_of)], given, robot).measurement
    truth = motion(data.time)
    np.testing.assert_allclose(data.qpos[:, 0], truth["q1"], atol=1e-9)
    np.testing.assert_allclose(data.qvel[:, 0], truth["dq1"], atol=1e-9)
    np.testing.assert_allclose(data.qpos[:, 1], truth["q2"], atol=1e-9)
    np.testing.assert_allclose(data.ctrl[:, 0], truth["u"], atol=1e-9)


def test_readings_that_jump_by_a_turn_are_refused(robot, even, given):
    wrapped = {**even, "q1": (4 * even["q1"] + np.pi) % (2 * np.pi) - np.pi}
    with pytest.raises(InvalidInput, match=r"'q1' jumps by a turn at .* joints.shoulder.wrap"):
        convert([log(wrapped)], given, robot)
    wrong = changed(('position = "q1"', 'position = "q1"\nwrap = 360.0'))
    with pytest.raises(InvalidInput, match=r"also with joints.shoulder.wrap = 360.* right\?"):
        convert([log(wrapped)], wrong, robot)


def test_degrees_that_are_read_as_radians_lead_to_the_question_of_the_unit(robot, even, given):
    fast = {**even, "q1": np.degrees(even["q1"]) + 6.28 * (even["time"] > 5)}
    with pytest.raises(InvalidInput, match=r"19 turns in all; is joints.shoulder.unit right \(rad"):
        convert([log(fast)], given, robot)


def test_commands_change_within_rows_at_the_steps_of_the_model(robot, even):
    given = changed(('command = "u"', 'command = "u"\n[rows]\nperiod = 0.05'))
    data = convert([log(even)], given, robot).measurement
    assert data.ctrl_within is not None
    assert data.ctrl_within.shape[1] == 25
    times = data.time[:, None] + 0.002 * np.arange(25) + 0.001  # the middle of each step
    np.testing.assert_allclose(data.ctrl_within[..., 0], motion(times)["u"], atol=1e-9)
    np.testing.assert_allclose(data.ctrl, data.ctrl_within.mean(axis=1))


@pytest.mark.parametrize("delay", [0.02, -0.02])
def test_a_command_acts_later_by_its_delay(robot, even, delay):
    """Or earlier, where its stamp is of a late arrival."""
    given = changed(('command = "u"', f'command = "u"\ndelay = {delay}'))
    data = convert([log(even)], given, robot).measurement
    rows = data.time < 19.9  # the last command holds
    expected = motion(data.time[rows] - delay + 1e-9)["u"]
    np.testing.assert_allclose(data.ctrl[rows, 0], expected, atol=1e-9)


def two_clocks(robot, given, even, states_arrived, commands_arrived):
    names, time = ("q1", "dq1", "q2", "dq2"), even["time"]
    states = Stream({name: even[name] for name in names}, time, states_arrived)
    commands = Stream({"u": even["u"]}, time + 0.005, commands_arrived)
    warnings = convert([Log("run.mcap", (states, commands))], given, robot).warnings
    return [each for each in warnings if "two clocks" in each]


def test_a_bag_of_two_clocks_names_the_columns_of_each(robot, even, given):
    (late,) = two_clocks(robot, given, even, states_arrived=False, commands_arrived=True)
    assert late.startswith(
        "run.mcap has two clocks: times of their own for 'q1', 'q2', 'dq1', 'dq2', "
        "and the time of arrival in the bag for 'u'."
    )
    (early,) = two_clocks(robot, given, even, states_arrived=True, commands_arrived=False)
    assert "own for 'u', and the time of arrival in the bag for 'q1'" in early
    assert not two_clocks(robot, given, even, states_arrived=True, commands_arrived=True)
    assert not two_clocks(robot, given, even, states_arrived=False, commands_arrived=False)


def test_the_reading_that_the_docs_give_for_a_command_becomes_that_command(even):
    page = (ROOT / "docs/criticism.md").read_text()
    example = r'"deg"`, `scale = (\S+)` and `zero = (\S+)` takes\s.* = (\S+) degrees for (\S+) rad'
    ((scale, zero, reading, ctrl),) = re.findall(example, page)
    drive = f'command = "u"\nunit = "deg"\nscale = {scale}\nzero = {zero}'
    servo = mujoco.MjModel.from_xml_string(XML.replace("<motor", "<position"))
    sent = {**even, "u": np.full(len(even["time"]), float(reading))}
    data = convert([log(sent)], changed(('command = "u"', drive)), servo).measurement
    np.testing.assert_allclose(data.ctrl[:, 0], float(ctrl), atol=1e-6)


def test_an_actuator_that_was_off_has_a_constant(robot, even):
    given = changed(('command = "u"', "constant = 0.25"))
    data = convert([log(even)], given, robot).measurement
    np.testing.assert_array_equal(data.ctrl, 0.25)


def test_a_velocity_that_the_log_lacks_counts_as_not_measured(robot, even):
    given = changed(('velocity = "dq2"', ""))
    data = convert([log(even)], given, robot).measurement
    np.testing.assert_array_equal(data.qvel_std, [np.nan, np.inf])
    np.testing.assert_array_equal(data.is_measured(), [True, True, True, False])
    assert_is_the_motion(data, 1e-5)  # a start for the fit


def test_joints_without_a_velocity_are_named_with_what_a_criticism_leaves_out(robot, even, given):
    for settings, joints in ((changed(('velocity = "dq2"', "")), "slider"), (given, None)):
        warnings = convert([log(even)], settings, robot).warnings
        found = [each for each in warnings if "several at once" in each]
        assert len(found) == (joints is not None)
        assert all(f"no velocity is measured of {joints}: " in each for each in found)


def test_a_derived_velocity_has_errors_that_are_independent_between_rows(robot):
    rng = np.random.default_rng(1)
    columns = motion(np.arange(0, 60, 0.001))
    noise = 1e-3 * rng.normal(size=len(columns["time"]))
    given = changed(
        ('velocity = "dq1"', "derive_velocity = true"),
        ("[actuators", "[rows]\nperiod = 0.01\n[actuators"),
    )
    converted = convert([log({**columns, "q1": columns["q1"] + noise})], given, robot)
    data = converted.measurement
    error = data.qvel[:, 0] - motion(data.time)["dq1"]
    # the slope of a line through n readings of deviation s, over a window w: s sqrt(12/n) / w
    assert error.std() == pytest.approx(1e-3 * np.sqrt(12 / 10) / 0.01, rel=0.1)
    assert converted.noise[2] == pytest.approx(error.std(), rel=0.1)
    wrong = data.qpos[:, 0] - motion(data.time)["q1"]
    assert converted.noise[0] == pytest.approx(wrong.std(), rel=0.1)
    assert abs(np.corrcoef(error[:-1], error[1:])[0, 1]) < 3 / np.sqrt(len(error))


def test_a_velocity_cannot_be_derived_from_few_readings(robot, even):
    given = changed(
        ('velocity = "dq1"', "derive_velocity = true"),
        ("[actuators", "[rows]\nperiod = 0.01\n[actuators"),
    )
    with pytest.raises(InvalidInput, match=r"readings 0.004 s apart.*rows.period = 0.032 or so"):
        convert([log(even)], given, robot)


def test_the_period_that_is_advised_for_a_derived_velocity_is_accepted(even):
    """Eight readings are 32 ms, and seven steps of the model 35 ms."""
    slower = mujoco.MjModel.from_xml_string(XML.replace('timestep="0.002"', 'timestep="0.005"'))
    velocity = ('velocity = "dq1"', "derive_velocity = true")
    given = changed(velocity, ("[actuators", "[rows]\nperiod = 0.01\n[actuators"))
    with pytest.raises(InvalidInput, match=r"rows\.period = 0\.035 or so"):
        convert([log(even)], given, slower)
    given = changed(velocity, ("[actuators", "[rows]\nperiod = 0.035\n[actuators"))
    assert convert([log(even)], given, slower).period == pytest.approx(0.035)


def test_rows_are_as_far_apart_as_a_derived_velocity_needs(robot, even):
    given = changed(('velocity = "dq1"', "derive_velocity = true"))
    assert convert([log(even)], given, robot).period == pytest.approx(0.032)


def test_a_gap_parts_episodes_and_is_listed(robot, even, given):
    kept = (even["time"] < 5.001) | (even["time"] > 7.002)
    with_gap = {name: values[kept] for name, values in even.items()}
    converted = convert([log(with_gap)], given, robot)
    (record,) = converted.records
    ((first, last),) = set(record.gaps)
    assert (first, last) == pytest.approx((5.0, 7.004))
    assert record.seconds_left_out == pytest.approx(2.0, abs=0.05)
    assert_is_the_motion(converted.measurement, 1e-9)


def test_a_pose_has_the_same_position_whichever_turn_its_recording_began_in(robot, even):
    turning = changed(('position = "q1"', f'position = "q1"\nwrap = {2 * np.pi}'))
    wrapped = {**even, "q1": even["q1"] % (2 * np.pi)}
    later = even["time"] >= 1.1  # just below zero, which reads as nearly a whole turn
    assert wrapped["q1"][later][0] > 6
    first, second = (
        {name: values[rows] for name, values in wrapped.items()} for rows in (~later, later)
    )
    for logs in ([first, second], [second, first]):
        assert_is_the_motion(
            convert([log(each) for each in logs], turning, robot).measurement, 1e-9
        )


def test_a_joint_with_limits_turns_within_them(even):
    beyond = XML.replace('name="shoulder"', 'name="shoulder" range="350 490" limited="true"')
    turning = changed(('position = "q1"', f'position = "q1"\nwrap = {2 * np.pi}'))
    wrapped = {**even, "q1": even["q1"] % (2 * np.pi)}
    data = convert([log(wrapped)], turning, mujoco.MjModel.from_xml_string(beyond)).measurement
    truth = motion(data.time)["q1"] + 2 * np.pi
    np.testing.assert_allclose(data.qpos[:, 0], truth, atol=1e-9)


@pytest.mark.parametrize("pause", ["of both", "of commands", "of commands at the end"])
def test_no_row_has_a_command_from_before_a_pause(pause, robot, even, given):
    states = {name: even[name] for name in ("q1", "dq1", "q2", "dq2")}
    time, sent = even["time"], even["time"] + 0.003
    end = 30 if pause.endswith("end") else 14
    kept = (time < 12) | (time > 14) if pause == "of both" else np.full(len(time), True)
    of_states = Stream({name: values[kept] for name, values in states.items()}, time[kept])
    ramp = (sent < 12) | (sent > end)
    of_commands = Stream({"u": sent[ramp] / 20}, sent[ramp])
    converted = convert([Log("run.mcap", (of_states, of_commands))], given, robot)
    data = converted.measurement
    np.testing.assert_allclose(data.ctrl[:, 0], data.time / 20, atol=1e-3)
    assert converted.records[0].seconds_left_out > 1.9


def test_commands_that_come_when_something_changes_hold(robot, even, given):
    states = Stream({name: even[name] for name in ("q1", "dq1", "q2", "dq2")}, even["time"])
    commands = Stream({"u": np.array([0.0, 1.0, 0.5, -1.0])}, np.array([0.0, 1.0, 2.0, 12.0]))
    converted = convert([Log("run.mcap", (states, commands))], given, robot)
    assert converted.records[0].gaps == ()
    assert converted.measurement.ctrl[2000, 0] == 0.5


def test_a_command_that_was_sent_once_holds(robot, even, given):
    states = Stream({name: even[name] for name in ("q1", "dq1", "q2", "dq2")}, even["time"])
    commands = Stream({"u": np.array([0.25])}, np.array([0.0]))
    converted = convert([Log("run.mcap", (states, commands))], given, robot)
    assert set(converted.measurement.ctrl[:, 0]) == {0.25}


def test_a_trial_that_is_too_short_is_left_out_with_a_warning(robot, even):
    given = changed(('command = "u"', 'command = "u"\n[rows]\nepisode = "trial"'))
    trials = np.zeros(len(even["time"]))
    trials[-3:-1], trials[-1] = 1, 2
    converted = convert([log({**even, "trial": trials})], given, robot)
    assert [record.source for record in converted.records] == ["log.csv, trial 0"]
    assert [each for each in converted.warnings if "left out" in each] == [
        "log.csv, trial 1 is too short for an episode (rows: 2), and is left out",
        "log.csv, trial 2 is too short for an episode (rows: 1), and is left out",
    ]


def test_a_trial_that_is_too_short_decides_nothing_about_the_others(robot, even):
    """Neither how far apart rows are, nor that a slower sensor needs readings in it."""
    given = changed(('command = "u"', 'command = "u"\n[rows]\nepisode = "trial"'))
    trials = np.zeros(len(even["time"]))
    trials[-6:] = 1
    q2 = even["q2"].copy()
    q2[-5:] = np.nan
    time = even["time"].copy()
    time[-6:] = time[-7] + 0.1 * np.arange(1, 7)
    whole, cut = (
        convert([log({**each, "trial": trials[:n]})], given, robot)
        for n, each in (
            (len(time), {**even, "q2": q2, "time": time}),
            (len(time) - 6, {name: values[:-6] for name, values in even.items()}),
        )
    )
    assert whole.period == cut.period
    np.testing.assert_array_equal(whole.measurement.qpos, cut.measurement.qpos)


def test_a_recording_without_an_episode_does_not_hide_the_noise_of_others(robot, even, given):
    few = {name: values[:4] for name, values in even.items()}
    converted = convert([log(even), log(few, "short.csv")], given, robot)
    np.testing.assert_array_equal(converted.noise, convert([log(even)], given, robot).noise)


def test_a_sensor_that_saturates_is_refused_also_where_it_was_resampled(robot, given):
    rng = np.random.default_rng(0)
    columns = motion(np.cumsum(rng.uniform(0.0017, 0.0031, 5000)))
    clipped = {**columns, "q2": np.minimum(columns["q2"], 0.05)}
    with pytest.raises(
        InvalidInput, match=r"column 'q2' .slider.position. is saturated: .* of 5000 rows"
    ):
        convert([log(clipped)], given, robot)


def test_readings_before_the_first_command_saturate_nothing(robot, even, given):
    """A joint that rests at its limit until the logger has started everything."""
    rests = {**even, "q1": np.where(even["time"] < 8, -1.0, even["q1"])}
    rests["dq1"] = np.where(even["time"] < 8, 0.0, even["dq1"])
    states = Stream({name: rests[name] for name in ("q1", "dq1", "q2", "dq2")}, even["time"])
    later = even["time"] >= 9
    commands = Stream({"u": even["u"][later]}, even["time"][later])
    assert convert([Log("run.mcap", (states, commands))], given, robot).measurement.time[0] >= 9
    with pytest.raises(InvalidInput, match=r"'q1' .shoulder.position. is saturated"):
        convert([log(rests)], given, robot)


def test_a_wrong_unit_of_a_velocity_is_blamed_on_the_map(robot, even, given):
    fast = {**even, "dq1": even["dq1"] * 9.5}
    with pytest.raises(
        InvalidInput, match=r"times as far.* order .shoulder, slider.*velocity_unit"
    ):
        convert([log(fast)], given, robot)


def test_the_shortest_episodes_are_cut_where_rounding_would_make_them_shorter(robot, even):
    given = changed(('command = "u"', 'command = "u"\n[rows]\nseconds = 0.04'))
    rows = {name: values[:1006] for name, values in even.items()}
    spans = convert([log(rows)], given, robot).measurement.spans()
    assert {last - first for first, last in spans} == {10}
    assert len(spans) == 100


def test_the_period_that_is_chosen_or_asked_for_can_be_given(robot, given):
    """Readings of 2.9 ms, where the model's step is 2 ms."""
    columns = motion(np.arange(0, 20, 0.0029))
    assert convert([log(columns)], given, robot).period == pytest.approx(0.004)
    dense = changed(('command = "u"', 'command = "u"\n[rows]\nperiod = 0.002'))
    with pytest.raises(InvalidInput, match=r"0.0029 s apart; give rows.period = 0.004 or more"):
        convert([log(columns)], dense, robot)


def test_several_recordings_and_trials_are_episodes_of_their_own(robot, even, given):
    later = motion(even["time"] + 20)
    first, second = ({**each, "trial": np.floor(each["time"] / 5)} for each in (even, later))
    by_trial = changed(('command = "u"', 'command = "u"\n[rows]\nepisode = "trial"\nseconds = 5.0'))
    converted = convert([log(first), log(second, "second.csv")], by_trial, robot)
    assert len(converted.measurement.spans()) == 8
    assert [r.source for r in converted.records][:2] == ["log.csv, trial 0", "log.csv, trial 1"]


def test_streams_with_clocks_of_their_own_meet(robot, given):
    """Joint states every 4 ms, and commands every 20 ms that began earlier."""
    states, commands = motion(np.arange(1, 21, 0.004)), motion(np.arange(0, 20, 0.02) + 1e-6)
    of_states = Stream({n: states[n] for n in ("q1", "dq1", "q2", "dq2")}, states["time"])
    of_commands = Stream({"u": commands["u"]}, commands["time"])
    data = convert([Log("run.mcap", (of_states, of_commands))], given, robot).measurement
    assert data.time[0] == pytest.approx(1.0)
    assert_is_the_motion(data, 1e-9)
    np.testing.assert_allclose(data.ctrl[:200, 0], motion(data.time[:200] + 1e-5)["u"], atol=1e-2)


def test_commands_at_their_limits_are_counted(robot, even, given):
    converted = convert([log({**even, "u": np.clip(3 * even["u"], -1, 1)})], given, robot)
    assert converted.at_limit["motor"] == pytest.approx(
        np.mean(np.abs(3 * even["u"]) >= 1), abs=0.02
    )


def test_a_column_of_zeros_is_no_velocity(robot, even, given):
    still = {**even, "dq1": np.zeros(len(even["time"]))}
    with pytest.raises(
        InvalidInput, match=r"'dq1' .* is 0 in all rows.*leave joints.shoulder.velocity out"
    ):
        convert([log(still)], given, robot)


def test_a_joint_that_stays_put_is_refused_with_what_to_delete(robot, even, given):
    """Its velocity was refused first, and then its position without a remedy."""
    still = {**even, "q2": np.full(len(even["time"]), 0.05), "dq2": np.zeros(len(even["time"]))}
    with pytest.raises(
        InvalidInput, match=r"'q2' .* is 0.05 in all rows.*delete it and its actuators in the model"
    ):
        convert([log(still)], given, robot)


def test_a_period_that_the_model_cannot_step_is_refused(robot, even):
    given = changed(('command = "u"', 'command = "u"\n[rows]\nperiod = 0.011'))
    with pytest.raises(
        InvalidInput, match=r"0.011 s, which is no multiple of the model's step of 0.002"
    ):
        convert([log(even)], given, robot)


def test_a_log_that_is_too_short_is_refused(robot, even, given):
    with pytest.raises(InvalidInput, match=r"10 rows of 0.004 s long; give a smaller rows.period"):
        convert([log({n: v[:8] for n, v in even.items()})], given, robot)
    with pytest.raises(InvalidInput, match="are too few to tell effects from noise"):
        convert([log({n: v[:600] for n, v in even.items()})], given, robot)


def test_stamps_of_arrival_in_bursts_are_refused_with_what_to_name_instead(robot, even, given):
    """Three readings at once every 12 ms, as a network brings them."""
    number = np.arange(len(even["time"]))
    arrived = 0.012 * (number // 3 + 1) + 1e-4 * (number % 3)
    with pytest.raises(InvalidInput, match=r"bursts of about 3 readings, 0.1 ms apart: its stamps"):
        convert([log({**even, "time": arrived})], given, robot)


def test_degrees_that_are_given_for_radians_are_refused(robot, even, given):
    with pytest.raises(InvalidInput, match=r"moves 57.3 times as far"):
        convert([log({**even, "q1": np.degrees(even["q1"])})], given, robot)


def test_a_model_with_a_free_joint_is_refused(even, given):
    xml = "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    with pytest.raises(InvalidInput, match="free and ball joints are not supported"):
        convert([log(even)], given, mujoco.MjModel.from_xml_string(xml))


def test_a_measurement_survives_its_file(robot, even):
    given = changed(
        ('command = "u"', 'command = "u"\n[rows]\nperiod = 0.05'), ('velocity = "dq2"', "")
    )
    data = convert([log(even)], given, robot).measurement
    again = Measurement.from_npz(data.to_npz())
    for name in ("time", "qpos", "qvel", "ctrl", "episode", "qvel_std", "ctrl_within"):
        np.testing.assert_array_equal(getattr(again, name), getattr(data, name))


def test_what_looks_wrong_is_pointed_out(robot, even, given):
    """A joint that turns often, rows that are not the readings' own, a drive without a range."""
    turning = {**even, "q1": 12 * even["q1"], "dq1": 12 * even["dq1"]}
    ranged = XML.replace('name="slider"', 'name="slider" range="0 0.02" limited="true"')
    unlimited = ranged.replace('ctrlrange="-1 1" ctrllimited="true"', "")
    coarse = unlimited.replace('timestep="0.002"', 'timestep="0.003"')
    model = mujoco.MjModel.from_xml_string(coarse)
    warnings = convert([log(turning)], given, model).warnings
    assert [w.split(" ")[0] for w in warnings] == [
        *("shoulder", "slider", "shoulder", "rows", "motor")
    ]
    assert warnings[0] == "shoulder turns 4 times; is joints.shoulder.unit right (rad)?"
    (moved,) = convert([log(even)], given, robot).warnings  # no command made this motion
    assert moved.startswith("shoulder hardly accelerates by the commands to motor")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("<motor", '<position kp="300"', ["motor is a servo without forcerange"]),
        ("<motor", '<position kp="300" forcerange="-5 5"', []),
        ("<motor", "<motor", []),
        ('axis="0 1 0"', 'axis="0 1 0" actuatorfrcrange="-5 5"', []),
    ],
)
def test_a_servo_whose_force_has_no_limit_is_pointed_out(even, given, old, new, expected):
    """Sensible sizes were those of a robot of 300 N m and more."""
    servo = XML.replace("<motor", '<position kp="300"') if "axis" in old else XML
    model = mujoco.MjModel.from_xml_string(servo.replace(old, new))
    warnings = [w for w in convert([log(even)], given, model).warnings if "forcerange" in w]
    assert [warning.partition(" in the model")[0] for warning in warnings] == expected
    assert all("counts as 1.5e+03 (N or N m)" in warning for warning in warnings)  # a gear of 5


def test_stamps_since_1970_become_seconds_of_the_recording(robot, even, given):
    late = {**even, "time": even["time"] + 1.7e9}
    data = convert([log(late)], given, robot).measurement
    assert data.time[0] == pytest.approx(0, abs=1e-6)
    assert_is_the_motion(data, 1e-5)


@pytest.mark.parametrize(
    ("unit", "message"), [("ns", "in all, and ten or more"), ("s", "apart; is")]
)
def test_a_wrong_unit_of_time_is_suspected(robot, even, unit, message):
    given = changed(('command = "u"', f'command = "u"\n[time]\nunit = "{unit}"'))
    size = {"ns": 1e6, "s": 1000.0}[unit]
    with pytest.raises(InvalidInput, match=rf"{message}.*time.unit right"):
        convert([log({**even, "time": size * even["time"]})], given, robot)


def test_where_gaps_leave_too_little_the_unit_of_time_is_not_suspected(robot, even, given):
    kept = even["time"] % 1.0 < 0.1
    gaps = {name: values[kept] for name, values in even.items()}
    with pytest.raises(
        InvalidInput, match=r"have 1.96 s in all.*; of 19.1 s on record the rest is gaps"
    ):
        convert([log(gaps)], given, robot)


def test_a_missing_column_is_named_with_its_place_in_the_map(robot, even, given):
    del even["q2"]
    with pytest.raises(InvalidInput, match=r"^slider.position: there is no column in log.csv 'q2'"):
        convert([log(even)], given, robot)


def test_stamps_that_are_too_coarse_are_pointed_out(robot, even, given):
    """Rows every 4 ms with stamps of 10 ms: three fifths of the readings were dropped unnoticed."""
    coarse = {**even, "time": np.floor(even["time"] / 0.01 + 1e-6) * 0.01}
    warning, *_ = convert([log(coarse)], given, robot).warnings
    assert warning.startswith(
        "3000 of 5000 readings of 'q1', 'q2', 'dq1', 'dq2' and 1 more have the time of the one"
    )
    assert "shift commands" in warning


def test_readings_of_two_sources_in_one_column_are_pointed_out(robot, given):
    """Each logs every 10 ms, one .5 ms after the other."""
    rows = 2001
    number = np.arange(rows)
    columns = motion(0.01 * (number // 2) + 0.0005 * (number % 2))
    usual = motion(np.arange(0, 0.005 * rows, 0.004))
    two = Stream({name: columns[name] for name in ("q1", "dq1")}, stamps=columns["time"])
    one = Stream({name: usual[name] for name in ("q2", "dq2", "u")}, stamps=usual["time"])
    warnings = convert([Log("run.mcap", (two, one))], given, robot).warnings
    found = [each for each in warnings if "come less than half the usual spacing" in each]
    assert [each.partition(" are left out")[0] for each in found] == [
        f"{rows // 2} of {rows} readings of {name!r}" for name in ("q1", "dq1")
    ]


def test_a_few_readings_at_one_time_are_not_pointed_out(robot, even, given):
    time = even["time"].copy()
    time[1:400] = time[np.arange(1, 400) // 2 * 2]
    warnings = convert([log({**even, "time": time})], given, robot).warnings
    assert not [each for each in warnings if "have the time of the one before" in each]


@pytest.mark.parametrize(("seconds", "expected"), [(3.0, 0), (6.0, 1)])
def test_a_large_share_of_time_that_is_left_out_is_pointed_out(
    robot, even, given, seconds, expected
):
    kept = (even["time"] < 5.001) | (even["time"] > 5 + seconds)
    with_gap = {name: values[kept] for name, values in even.items()}
    warnings = convert([log(with_gap)], given, robot).warnings
    assert len([each for each in warnings if "s were left out" in each]) == expected


def repeats(warnings):
    return [each for each in warnings if "repeat its readings" in each]


@pytest.mark.parametrize("every", [2, 5])
def test_rows_that_repeat_the_readings_of_a_slow_sensor_are_pointed_out(robot, even, given, every):
    rows = np.arange(len(even["time"])) // every * every
    (warning,) = repeats(convert([log({**even, "q1": even["q1"][rows]})], given, robot).warnings)
    assert warning.startswith(f"column 'q1' changes every {4 * every} ms only")
    assert "leave it out (an empty cell is no reading)" in warning


def test_a_coarse_encoder_and_a_joint_that_rests_repeat_no_readings(robot, even):
    given = changed(('velocity = "dq2"', ""))
    step = 2 * np.pi / 256
    coarse = {**even, "q1": step * np.round(even["q1"] / step)}
    rests = np.where(even["time"] % 6 < 4, 0.02, even["q2"])
    for columns in (coarse, {**even, "q2": rests}):
        assert not repeats(convert([log(columns)], given, robot).warnings)

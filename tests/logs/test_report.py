"""The page about a conversion."""

import re
from dataclasses import replace

import numpy as np

from adr_service.criticism.excitation import Excitation
from adr_service.logs.conversion import convert
from adr_service.logs.report import report_page
from tests.logs.conftest import log

SHOWN = [
    Excitation("joint_spring", "joint:shoulder", 900.0, "stiffness", 0.4, 0.01, "N m/rad"),
    Excitation("body_mass", "body:<forearm>", 3.0, "mass", 0.2, 0.5, "kg"),
]


def page(robot, columns, given, shown=SHOWN):
    return report_page(convert([log(columns)], given, robot), shown, robot, "log.csv")


def test_the_page_lists_columns_motion_and_effects(robot, even, given):
    text = page(robot, even, given)
    assert "20 episodes of 250 rows, 4 ms apart: 4980 transitions" in text
    assert "cubic spline through all readings" in text
    assert "1 effects that these data cannot show" in text
    assert "body:&lt;forearm&gt;" in text  # names are the model's, and no HTML
    assert text.count("<svg") == 1


def test_the_page_says_what_was_left_out(robot, even, given):
    kept = (even["time"] < 5.001) | (even["time"] > 7.002)
    times = even["time"][kept].copy()
    times[10] = times[9] + 1e-4
    columns = {n: v[kept] for n, v in even.items()} | {"time": times}
    text = page(robot, columns, given)
    assert "Gaps, in which nothing was measured: 5 to 7.004 s" in text
    assert "1 readings of a column were left out" in text


def test_the_page_counts_commands_at_a_limit(robot, even, given):
    saturated = {**even, "u": np.clip(3 * even["u"], -1, 1)}
    assert "motor: " in page(robot, saturated, given)
    assert "of all rows are at the model's limit or beyond" in page(robot, saturated, given)


def test_a_speed_that_touches_zero_is_no_reversal_and_one_that_crosses_it_is_one(
    robot, even, given
):
    """The episodes are of 250 rows; the slider rests for two rows of each, and turns in one."""
    row = np.arange(len(even["time"])) % 250
    rests = (row == 50) | (row == 51) | (row == 100)
    speed = np.where(rests, 0.0, np.where(row > 100, -0.01, 0.01))
    converted = convert([log(even)], given, robot)
    data = converted.measurement
    qvel = np.column_stack([data.qvel[:, 0], speed[: len(data.time)]])
    moved = replace(converted, measurement=replace(data, qvel=qvel))
    text = report_page(moved, SHOWN, robot, "log.csv")
    (cells,) = re.findall(r"<tr><td>slider</td>(.*?)</tr>", text)
    assert re.findall(r"<td>(.*?)</td>", cells)[2] == "20"


def test_the_same_conversion_gives_the_same_page(robot, even, given):
    assert page(robot, even, given) == page(robot, even, given)


def test_data_that_show_nothing_say_so(robot, even, given):
    assert "<b>Nothing.</b>" in page(robot, even, given, SHOWN[1:])

"""Logs that share rows, which would count twice."""

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.logs.base import Log, Stream
from adr_service.logs.conversion import convert
from adr_service.logs.overlaps import check_logs_apart
from tests.logs.conftest import log, motion


def rows(columns, chosen):
    return {name: values[chosen] for name, values in columns.items()}


def test_two_parts_of_one_log_that_share_rows_are_refused_with_the_rows(robot, even, given):
    parts = [
        log(rows(even, slice(None, 3000)), "a.csv"),
        log(rows(even, slice(2900, None)), "b.csv"),
    ]
    where = "a.csv from row 2901 below the header on and b.csv from row 1 below the header on have"
    with pytest.raises(InvalidInput, match=where):
        convert(parts, given, robot)
    apart = [log(rows(even, slice(None, 2900)), "a.csv"), parts[1]]
    assert convert(apart, given, robot).measurement.spans()


def test_ten_shared_rows_are_refused_and_nine_are_not(even, given):
    first = log(rows(even, slice(None, 1000)), "a.csv")
    check_logs_apart([first, log(rows(even, slice(991, None)), "b.csv")], given)
    with pytest.raises(InvalidInput, match="give each row of a recording once"):
        check_logs_apart([first, log(rows(even, slice(990, None)), "b.csv")], given)


def test_messages_of_two_bags_that_overlap_are_named(given):
    def bag(source, times):
        columns = motion(times)
        return Log(source, (Stream(columns | {"other": times}, columns.pop("time")),))

    times = np.arange(0, 10, 0.01)
    with pytest.raises(
        InvalidInput, match=r"a\.mcap from message 501 on and b\.mcap from message 1"
    ):
        check_logs_apart([bag("a.mcap", times[:600]), bag("b.mcap", times[500:])], given)


def test_robots_that_rest_at_the_same_time_of_their_own_clocks_share_nothing(even, given):
    """Both wait in the same place, as a coarse sensor shows it, and then move apart."""
    waits = {n: np.where(even["time"] < 1, 0.0, v) for n, v in even.items() if n != "time"}
    second = {name: -values for name, values in waits.items()}
    logs = [log({**each, "time": even["time"]}) for each in (waits, second)]
    check_logs_apart(logs, given)


def test_the_same_motion_at_another_time_is_no_overlap(even, given):
    check_logs_apart([log(even), log({**even, "time": even["time"] + 100})], given)

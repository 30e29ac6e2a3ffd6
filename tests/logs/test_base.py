"""Columns of a log as signals."""

import numpy as np
import pytest

from adr_service.errors import InvalidInput, UnknownName
from adr_service.logs.base import Clock, Log, Stream, check_size
from tests.logs.conftest import log, motion

SECONDS = Clock("time", "s")


def test_rows_without_a_reading_are_left_out():
    columns = {"time": np.array([0.0, 1, 2, 3]), "q": np.array([5.0, np.nan, 7, 8])}
    signal = log(columns).signal("q", SECONDS)
    np.testing.assert_array_equal(signal.time, [0, 2, 3])
    np.testing.assert_array_equal(signal.value, [5, 7, 8])


def test_nanoseconds_since_1970_keep_microseconds():
    stamps = 1.7e18 + np.array([0.0, 2e6, 4e6])
    signal = log({"t": stamps, "q": np.arange(3.0)}).signal("q", Clock("t", "ns"))
    np.testing.assert_allclose(np.diff(signal.time), 0.002, atol=1e-6)


@pytest.mark.parametrize(("whole", "rest"), [("t.sec", "t.nanosec"), ("secs", "nsecs")])
def test_seconds_and_nanoseconds_in_two_columns_are_added(whole, rest):
    columns = {whole: np.array([0, 0, 1, np.nan]) + 1.7e9, rest: np.array([0, 5e8, 0, 0])}
    table = log({**columns, "q": np.arange(4.0)})
    signal = table.signal("q", Clock(whole, "s", rest))
    np.testing.assert_allclose(signal.time - 1.7e9, [0, 0.5, 1])
    with pytest.raises(InvalidInput, match=f"give time.nanoseconds = '{rest}' as well"):
        table.signal("q", Clock(whole, "s"))


def test_seconds_with_a_fraction_need_no_nanoseconds_beside_them():
    columns = {"sec": np.array([0, 0.5, 1]), "nanosec": np.array([0, 5e8, 0]), "q": np.arange(3.0)}
    np.testing.assert_array_equal(log(columns).signal("q", Clock("sec", "s")).time, [0, 0.5, 1])


def test_readings_too_soon_after_another_are_left_out_and_counted():
    columns = {"time": np.array([0.0, 1, 1, 2, 2.4, 3]), "q": np.array([5.0, 6, 7, 8, 9, 10])}
    signal = log(columns).signal("q", SECONDS)
    np.testing.assert_array_equal(signal.value, [5, 6, 8, 10])
    assert signal.crowded == 2


def test_readings_without_a_time_are_left_out_and_counted():
    columns = {"time": np.array([0.0, np.nan, 1, 2]), "q": np.array([5.0, 6, np.nan, 8])}
    signal = log(columns).signal("q", SECONDS)
    np.testing.assert_array_equal(signal.value, [5, 8])
    assert (signal.timeless, signal.crowded) == (1, 0)


def test_commands_that_hold_are_all_kept_but_for_the_last_of_one_time_alone():
    time = np.array([0.0, 2, 2.4, 4.4, 4.4, 6.4, 6.9, 9, 9])
    columns = {"time": time, "u": np.arange(9.0)}
    signal = log(columns).commands("u", SECONDS)
    np.testing.assert_array_equal(signal.value, [0, 1, 2, 4, 5, 6, 8])
    assert signal.crowded == 2
    single = {name: values[:1] for name, values in columns.items()}
    np.testing.assert_array_equal(log(single).commands("u", SECONDS).value, [0])
    with pytest.raises(InvalidInput, match=r"has 1 readings .* needed: 2 or more"):
        log(single).signal("u", SECONDS)


def test_a_clock_that_stands_still_is_refused():
    columns = {"time": np.ones(9), "q": np.arange(9.0)}
    with pytest.raises(InvalidInput, match="has 1 readings with a time of their own"):
        log(columns).signal("q", SECONDS)


def test_time_that_runs_backwards_is_refused_with_its_row():
    time = 1.7e9 + np.array([0.0, 1, np.nan, 0.5])
    columns = {"time": time, "q": np.arange(4.0)}
    with pytest.raises(
        InvalidInput, match=r"back by 0.5 s at row 4 below the header.*rows.episode"
    ):
        log(columns).signal("q", SECONDS)


def test_rows_of_a_part_are_counted_from_the_start_of_the_log():
    columns = {"time": np.array([0.0, 1, 2, 0, 1, 0]), "trial": np.array([1.0, 1, 1, 2, 2, 2])}
    part = log({**columns, "q": np.arange(6.0)}).parts("trial")[1]
    with pytest.raises(InvalidInput, match="back by 1 s at row 6 below the header"):
        part.signal("q", SECONDS)


def test_a_bags_topic_may_have_a_clock_of_its_own_among_its_fields():
    """A counter of the robot's board, where the bag knows the arrival alone."""
    state = {"/state.q": np.arange(3.0), "/state.tick": np.array([10.0, 12, 14])}
    bag = Log(
        "a.mcap",
        (
            Stream(state, stamps=np.array([5.0, 5.0001, 5.0002]), has_arrivals=True),
            Stream({"/command.u": np.arange(2.0)}, stamps=np.array([5.0, 6]), has_arrivals=True),
        ),
    )
    clock = Clock("/state.tick", "ms")
    signal = bag.signal("/state.q", clock)
    np.testing.assert_allclose(signal.time, [0.010, 0.012, 0.014])
    assert not signal.has_arrivals
    other = bag.signal("/command.u", clock)
    np.testing.assert_array_equal(other.time, [5, 6])
    assert other.has_arrivals
    with pytest.raises(UnknownName, match=r"column in a.mcap '/state.tock'; did you mean"):
        bag.signal("/state.q", Clock("/state.tock", "ms"))


def test_stamps_that_run_backwards_lead_to_one_bag_for_each_recording():
    bag = Log("a.mcap", (Stream({"q": np.arange(3.0)}, stamps=np.array([5.0, 6, 2])),))
    with pytest.raises(
        InvalidInput, match=r"'q' goes back by 4 s at message 3; give one bag for each recording$"
    ):
        bag.signal("q", SECONDS)


def test_infinite_readings_and_times_are_refused_with_their_number_and_first_row():
    columns = {"time": np.arange(4.0), "q": np.array([0, np.nan, np.inf, -np.inf])}
    message = r"'q' has 2 infinite readings, the first at row 3 below the header; leave such cells"
    for read in (log(columns).signal, log(columns).commands):
        with pytest.raises(InvalidInput, match=message):
            read("q", SECONDS)
    columns = {"time": np.array([0, np.inf, 2, 3]), "q": np.arange(4.0)}
    with pytest.raises(InvalidInput, match=r"'time' has 1 infinite readings, the first at row 2"):
        log(columns).signal("q", SECONDS)


def test_an_unknown_column_and_an_unknown_clock_list_those_there_are():
    columns = {"time": np.arange(3.0), "shoulder": np.arange(3.0)}
    with pytest.raises(InvalidInput, match=r"'\?' is what a draft has.*in log.csv: time, shoulder"):
        log(columns).signal("?", SECONDS)
    with pytest.raises(UnknownName, match="did you mean 'shoulder'"):
        log(columns).signal("sholder", SECONDS)
    with pytest.raises(UnknownName, match=r"column in log.csv 'stamp'.*accepted: time, shoulder"):
        log(columns).signal("shoulder", Clock("stamp", "s"))


def test_a_column_of_text_is_refused():
    unread = {"mode": "it holds string"}
    table = Log("a.csv", (Stream({"time": np.arange(3.0)}),), unread)
    with pytest.raises(InvalidInput, match="'mode' has no numbers to read: it holds string"):
        table.signal("mode", SECONDS)
    stamps = Log("a.csv", (Stream({"q": np.arange(3.0)}),), {"time": "it holds the text 'ERR'"})
    with pytest.raises(InvalidInput, match="'time' has no numbers to read: it holds the text 'ERR"):
        stamps.signal("q", SECONDS)


def test_the_reason_why_a_topic_or_a_list_has_no_column_is_given():
    unread = {"/state": "its messages are in 'ros1'", "/state.q": "it is a list of 300 places"}
    bag = Log("a.mcap", (Stream({"/command.u": np.zeros(3)}, stamps=np.arange(3.0)),), unread)
    with pytest.raises(InvalidInput, match="'/state' cannot be read: its messages are in 'ros1'"):
        bag.signal("/state.dq", SECONDS)
    with pytest.raises(
        InvalidInput, match=r"'/state\.q' cannot be read: it is a list of 300 places"
    ):
        bag.signal("/state.q_280", SECONDS)
    with pytest.raises(UnknownName, match=r"there is no column in a\.mcap '/statement'"):
        bag.signal("/statement", SECONDS)


def test_a_log_parts_where_a_column_changes():
    columns = {**motion(np.arange(6.0)), "trial": np.array([1.0, 1, 1, 2, 2, 2])}
    first, second = log(columns).parts("trial")
    assert (first.source, second.source) == ("log.csv, trial 1", "log.csv, trial 2")
    np.testing.assert_array_equal(second.streams[0].columns["time"], [3, 4, 5])


def test_parts_of_a_bag_of_one_topic_keep_the_stamps_of_their_rows():
    columns = {"q": np.arange(6.0), "trial": np.array([1.0, 1, 1, 2, 2, 2])}
    bag = Log("a.mcap", (Stream(columns, stamps=np.arange(10.0, 16)),))
    second = bag.parts("trial")[1].signal("q", SECONDS)
    np.testing.assert_array_equal(second.time, [13, 14, 15])
    np.testing.assert_array_equal(second.value, [3, 4, 5])


def test_a_part_without_a_number_is_refused():
    columns = {**motion(np.arange(3.0)), "trial": np.array([1.0, np.nan, 2])}
    with pytest.raises(InvalidInput, match=r"'trial' of rows.episode has no .* at row 2 below"):
        log(columns).parts("trial")


def test_a_log_without_rows_has_no_parts():
    with pytest.raises(InvalidInput, match=r"log\.csv has no rows"):
        log({"time": np.zeros(0), "trial": np.zeros(0)}).parts("trial")


def test_a_bag_has_no_parts():
    streams = (Stream({"trial": np.zeros(3)}), Stream({"q": np.zeros(3)}))
    with pytest.raises(InvalidInput, match="Give one bag for each recording"):
        Log("a.mcap", streams).parts("trial")


def test_more_than_a_criticism_could_use_is_refused():
    with pytest.raises(InvalidInput, match=r"has 5,000 columns and 10 numbers; accepted are 4,096"):
        check_size("a.csv", 5000, 10)
    with pytest.raises(InvalidInput, match="8 columns and 33,554,433 numbers"):
        check_size("a.csv", 8, 2**25 + 1)
    check_size("a.csv", 8, 2**25)

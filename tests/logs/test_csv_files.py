"""Tables of text."""

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.logs.csv_files import read_csv


def columns(text):
    log = read_csv("log.csv", text.encode(errors="surrogateescape"))
    return log.streams[0].columns, log.unread


def text(cell, row=1):
    """The reason why a column of texts cannot be read."""
    return f"it holds the text {cell!r}, first in row {row} below the header; accepted are numbers"


def test_two_decimal_marks_in_a_column_are_both_shown():
    _, unread = columns("time;q\n0;1\n1;2,5\n2;3.5\n")
    assert unread["q"] == (
        "it has two decimal marks: '2,5', first in row 2 below the header, and '3.5', first in row "
        "3 below the header; accepted is one"
    )


@pytest.mark.parametrize(
    "text",
    [
        "time,q 1\n0,1.5\n0.1,2.5\n",
        "time;q 1\n0;1,5\n0,1;2,5\n",
        "time\tq 1\n0\t1.5\n0.1\t2.5\n",
        "\ufefftime, q 1 \n0,1.5\n0.1,2.5\n",
        "# time,q 1\n0,1.5\n0.1,2.5\n",
        "# by a logger, of 2026\n# time,q 1\n0,1.5\n0.1,2.5\n",
        "# by a logger, of 2026\ntime,q 1\n0,1.5\n0.1,2.5\n",
        "# logger v2\n# rate, 500\ntime,q 1\n0,1.5\n0.1,2.5\n",
        "# time,q 1\n# rate, 500\n0,1.5\n0.1,2.5\n",
        "time\tq 1\n0\t1,5\n0,1\t2,5e0\n",
        '"time";"q 1"\n"0";"1,5"\n"0,1";"2,5"\n',
        '# time;q 1\n"0";"1,5"\n"0,1";"2,5"\n',
        "\n \ntime,q 1\n0,1.5\n0.1,2.5\n",
        "# robot 7\r\n\r\ntime,q 1\r\n0,1.5\r\n0.1,2.5\r\n",
        "# robot 7\n\n# time,q 1\n\n0,1.5\n0.1,2.5\n",
    ],
)
def test_commas_semicolons_tabs_and_marks_before_the_header_are_read(text):
    found, _ = columns(text)
    assert list(found) == ["time", "q 1"]
    np.testing.assert_array_equal(found["q 1"], [1.5, 2.5])


def test_whole_nanoseconds_since_1970_are_read():
    found, _ = columns("stamp,q\n1700000000123456789,1\n1700000000125456789,2\n")
    np.testing.assert_allclose(np.diff(found["stamp"]), 2e6, atol=300)


def test_semicolons_go_with_decimal_points_too():
    found, _ = columns("time;q\n0.5;1.5\n")
    np.testing.assert_array_equal(found["q"], [1.5])


def test_a_list_in_a_cell_is_no_decimal_comma_among_numbers_with_points():
    found, texts = columns("time\tq\tmode\n0.5\t1.5\t1,2\n")
    assert (found["time"][0], found["q"][0]) == (0.5, 1.5)
    assert texts == {"mode": text("1,2")}


def test_a_column_with_points_among_decimal_commas_is_a_text():
    found, texts = columns("time;q;version\n0,1;1,5;2.1\n0,2;1,6;2.1\n")
    np.testing.assert_array_equal(found["q"], [1.5, 1.6])
    assert texts == {"version": text("2.1")}


def test_a_comma_within_a_text_is_no_decimal_comma():
    found, texts = columns("time;q;note\n0.5;1.5;a, b\n")
    assert (found["time"][0], found["q"][0]) == (0.5, 1.5)
    assert texts == {"note": text("a, b")}


def test_columns_without_a_name_are_told_apart():
    found, _ = columns("time,q,,\n0,1,,\n1,2,,\n")
    assert list(found) == ["time", "q", "unnamed_2", "unnamed_3"]


def test_an_empty_cell_is_no_reading():
    found, _ = columns("time,q\n0,1\n1,\n2,3\n")
    np.testing.assert_array_equal(found["q"], [1, np.nan, 3])


def test_texts_are_listed_and_dates_are_seconds():
    found, texts = columns("stamp,mode,q\n2026-01-01 00:00:00.5,on,1\n2026-01-01 00:00:01,on,2\n")
    assert texts == {"mode": text("on")}
    np.testing.assert_allclose(np.diff(found["stamp"]), 0.5)


def test_the_odd_cell_of_a_column_is_named():
    found, texts = columns("time,q\n0,1\n1,\n2,NaN\n3,overflow!\n4,2\n")
    assert list(found) == ["time"]
    assert texts == {"q": text("overflow!", 4)}


def test_the_odd_cell_among_decimal_commas_is_named():
    _, texts = columns("t;q\n0,5;1,5\n1,5;overflow!\n")
    assert texts == {"q": text("overflow!", 2)}


@pytest.mark.parametrize("cell", ["12:00:00.005", "12.5 deg"])
def test_the_first_cell_of_a_text_is_quoted(cell):
    _, texts = columns(f"t,q\n1,\n2,{cell}\n3,{cell[::-1]}\n")
    assert texts == {"q": text(cell, 2)}


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_a_table_in_another_encoding_is_refused_with_the_one_that_is_accepted(encoding):
    content = "\ufefftime,q\n0,1\n".encode(encoding)
    with pytest.raises(InvalidInput, match=r"log\.csv is in UTF-16; accepted is UTF-8"):
        read_csv("log.csv", content)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n3\n", "Expected 2 columns, got 1"),
        ("", "Empty CSV file"),
        ("\n\n", "Empty CSV file"),
        ("0.1,0.2,0.3\n1,2,3\n", "begins with numbers .0.1, 0.2, 0.3, ….; expected are names"),
        ("q,q\n1,2\n", "has columns twice: q"),
        ("t q u\n1 2 3\n", "one column, 't q u'; expected are several, separated by commas"),
        ("q \udcb0,p\n1,2\n", "is no table that can be read"),
    ],
)
def test_what_is_no_table_is_refused(text, message):
    with pytest.raises(InvalidInput, match=message):
        columns(text)

"""The width of tables, and text as it is."""

import pytest

from tests.packages import python

WORDS = "the robot showed [nan, 0.3]: in rec[/old].npz"
PRINT_WORDS = f"""
from rich.table import Table
from api.cli.terminal import console, errors
table = Table("[nan, 1]")
table.add_row("[/b]")
for each in (console, errors):
    each.print({WORDS!r})
    each.print(table)
"""
PRINT_WIDTH = "from api.cli.terminal import console; print(console.width)"


@pytest.mark.parametrize(("columns", "width"), [(None, "120"), ("200", "200")])
def test_a_table_has_a_width_where_the_output_is_no_terminal(monkeypatch, columns, width):
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)
    assert python(PRINT_WIDTH).stdout.strip() == width


def test_brackets_are_no_markup():
    """Rich would leave `[nan, …]` out, and end the command at `[/…]`."""
    shown = python(PRINT_WORDS)
    for text in (shown.stdout, shown.stderr):
        assert all(part in text for part in (WORDS, "[nan, 1]", "[/b]"))

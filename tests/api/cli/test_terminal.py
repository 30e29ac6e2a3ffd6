"""The width of tables."""

import pytest

from tests.packages import python

PRINT_WIDTH = "from api.cli.terminal import console; print(console.width)"


@pytest.mark.parametrize(("columns", "width"), [(None, "120"), ("200", "200")])
def test_a_table_has_a_width_where_the_output_is_no_terminal(monkeypatch, columns, width):
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)
    assert python(PRINT_WIDTH).stdout.strip() == width

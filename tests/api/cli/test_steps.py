"""Lines of a long computation."""

import io

import pytest
from rich.console import Console

from api.cli import steps
from api.cli.steps import progress_on


@pytest.fixture
def output():
    return io.StringIO()


def test_each_step_is_a_line_where_the_output_is_no_terminal(output):
    with progress_on(Console(file=output)) as progress:
        for fraction, doing in ((0.1, "fitting"), (0.2, "fitting"), (0.8, "weighing")):
            progress(fraction, doing=doing)
    assert output.getvalue().splitlines() == ["0 s, 10%: fitting", "0 s, 80%: weighing"]


def test_a_step_that_lasts_is_told_again(output, monkeypatch):
    monkeypatch.setattr(steps, "_AGAIN_S", -1.0)
    with progress_on(Console(file=output)) as progress:
        progress(0.1, doing="fitting")
        progress(0.2, doing="fitting")
    assert output.getvalue().splitlines() == ["0 s, 10%: fitting", "0 s, 20%: fitting"]

"""The tables of docs/tasks.md say what the code does."""

import re
from pathlib import Path

import pytest

from adr_service.simulation.batch import control_period
from adr_service.tasks.catalogue import BUILT_IN

PAGE = (Path(__file__).parent.parent / "docs/tasks.md").read_text()


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_table_of_tasks_is_right(name):
    task, variants = BUILT_IN[name].task, BUILT_IN[name].variants
    seen = str(len(task.columns))
    if task.measured < len(task.columns):
        seen += f", of which {task.measured} measured"
    cells = [
        f"`{name}`",
        seen,
        str(len(task.action_low)),
        f"{len(variants['vanilla'].source.space)} ({len(variants['unmodeled'].source.space)})",
        f"{variants['noisy'].hidden.noise_variance:.0e}".replace("e-0", "e-"),
        f"{1000 * control_period(task):g} ms",
        f"{task.reward_threshold:g}",
        f"{task.learning_rate:.0e}".replace("e-0", "e-"),
    ]
    assert f"| {' | '.join(cells)} |" in PAGE


def test_nothing_is_left_to_fill_in():
    assert not re.search(r"@\w+@", PAGE)
    for picture in re.findall(r"\((pictures/[^)]+)\)", PAGE):
        assert (Path(__file__).parent.parent / "docs" / picture).is_file()


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_table_of_a_tasks_parameters_is_right(name):
    hidden = BUILT_IN[name].variants["vanilla"].hidden
    wrong = {p.name: p for p in BUILT_IN[name].variants["unmodeled"].source.space.parameters}
    section = PAGE.split(f"\n## {name}\n")[1].split("\n## ")[0]
    for parameter, value in zip(hidden.source.space.parameters, hidden.values, strict=True):
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        other = wrong.get(parameter.name)
        if other is None:
            unmodeled = f"frozen at {0.8 * value:.4g}"
        elif (other.low, other.feasible_low) == (parameter.low, parameter.feasible_low):
            unmodeled = "same"
        else:
            unmodeled = f"{other.low:g} – {other.high:g}, from {other.feasible_low:g}"
        bounds = f"{parameter.low:g} – {parameter.high:g}"
        cells = [parameter.name, f"{value:.5g}{unit}", bounds, f"{parameter.feasible_low:g}"]
        assert f"| {' | '.join(cells)} | {unmodeled} |" in section
    assert section.count("\n| ") - 1 == len(hidden.values)

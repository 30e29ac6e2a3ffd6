"""The page docs/add-a-method.md, followed: its file and its package, installed and run."""

import re

import pytest

from tests.packages import ROOT, add_entry_point, install, python

PAGE = (ROOT / "docs/add-a-method.md").read_text()

USE = """
from adr_service.benchmark.comparison import Outcome, table
from adr_service.benchmark.figures import draw
from adr_service.stages.local import LocalStages
from adr_service.programs import run
from adr_service.specs import BenchmarkSpec

spec = BenchmarkSpec.model_validate({
    "tasks": ["arm"], "methods": [{"name": "random_search", "guesses": 300}], "seeds": [0],
    "preset": "smoke", "transitions": 100})
stages, outcomes = LocalStages(), []
for one in spec.runs():
    outcomes += [Outcome(one, e) for e in run(one, stages) if e.type == "iteration_finished"]
rows = table(outcomes)
assert [row.method for row in rows] == ["random_search"] * 2 + ["prior", "oracle"], rows
assert rows[1].estimation_error < 0.5 * rows[0].estimation_error, rows[:2]
assert b"random_search" in draw("returns", outcomes, "svg")
search, = (s for s in stages.executed if s.kind == "infer")
assert search.inputs["method_package"] == "adr-random-search 0.1.0"
print("fine")
"""


def block(language, marker):
    """The page's code block of a language that has the marker."""
    blocks = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return next(code for code in blocks if marker in code)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder to import the page's package from."""
    folder, source = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("source")
    (source / "random_search.py").write_text(block("python", "class RandomSearch:"))
    (source / "pyproject.toml").write_text(block("toml", "entry-points"))
    install(source, folder)
    return folder


def test_the_pages_method_runs_in_a_benchmark(installed):
    done = python(USE, installed)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "fine"


def test_the_page_can_be_followed_word_for_word(installed, tmp_path):
    (tmp_path / "try_it.py").write_text(block("python", "simulate_rollout"))
    done = python((tmp_path / "try_it.py").read_text(), installed)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() in PAGE


def test_it_can_be_imported_before_anything_of_ours(installed):
    done = python("import random_search; import adr_service.specs", installed)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("adr_service.methods.base:OfflineSettings", "which lacks create, planned_steps"),
        ("nowhere:Settings", "cannot be loaded"),
        ("adr_service.methods.udr:UdrSettings", "a subclass of OfflineSettings or OnlineSettings"),
        ("random_search:RandomSearchSettings", "a method of another name, 'random_search'"),
    ],
)
def test_an_entry_point_that_leads_wrong_is_named(installed, tmp_path, value, message):
    add_entry_point(tmp_path, "adr_service.methods", value)
    done = python("import adr_service.specs", tmp_path, installed)
    assert message in done.stderr
    assert "'broken'" in done.stderr

"""A method of a user's own, by the page docs/add-a-method.md: one file, and nothing else."""

import re

import pytest

from adr_service.tasks.catalogue import source_of
from tests.packages import ROOT, add_entry_point, install, python

PAGE = (ROOT / "docs/add-a-method.md").read_text()

# what a benchmark needs of a method: a plan, runs, a table and a figure
USE = """
from adr_service.benchmark.comparison import Outcome, table
from adr_service.benchmark.figures import draw
from adr_service.benchmark.plan import plan
from adr_service.methods.catalogue import methods
from adr_service.programs import run
from adr_service.specs import BenchmarkSpec
from adr_service.stages.local import LocalStages

assert "random_search" in methods()
spec = BenchmarkSpec.model_validate({
    "tasks": ["arm"], "methods": [{"name": "random_search", "guesses": 300}], "seeds": [0],
    "preset": "smoke", "transitions": 100})
costs = plan(list(spec.runs()), cores=2)
assert costs.runs == 3 and costs.core_hours > 0, costs
stages, outcomes = LocalStages(), []
for one in spec.runs():
    outcomes += [Outcome(one, e) for e in run(one, stages) if e.type == "iteration_finished"]
assert costs.trainings == sum(s.kind == "train_policy" for s in stages.executed), costs
rows = table(outcomes)
assert [row.method for row in rows] == ["random_search"] * 2 + ["prior", "oracle"], rows
assert rows[1].estimation_error < 0.5 * rows[0].estimation_error, rows[:2]
assert b"random_search" in draw("returns", outcomes, "svg")
search, = (s for s in stages.executed if s.kind == "infer")
print(search.inputs.get("method_package"))
"""
# the same of a curriculum
USE_RAMP = """
from adr_service.benchmark.plan import plan
from adr_service.methods.catalogue import methods
from adr_service.programs import run
from adr_service.specs import RunSpec
from adr_service.stages.local import LocalStages

assert "ramp" in methods()
spec = RunSpec.model_validate({
    "task": "arm", "method": {"name": "ramp", "phases": 2, "episodes": 12}, "preset": "smoke",
    "training": {"max_steps": 9600}})
assert plan([spec], cores=2).trainings == 1
stages = LocalStages()
(finished,) = (e for e in run(spec, stages) if e.type == "iteration_finished")
(training,) = (s for s in stages.executed if s.kind == "train_policy")
assert training.inputs["curriculum_package"] == "adr-random-search 0.1.0", training.inputs
(whole,) = finished.distributions
assert whole["kind"] == "uniform"
print(round(whole["high"][0] - whole["low"][0], 3))
"""
# its last box, in a search range whose centre less half of its width is a bit below its lower end
LAST_RAMP = """
from dataclasses import replace

from adr_service.methods.base import Problem
from adr_service.parameters import ParameterSpace
from adr_service.tasks.catalogue import get_task, source_of
from ramp import RampSettings

source = source_of("arm", "vanilla")
parameter = replace(source.space.parameters[0], low=0.1, high=0.4, feasible_low=0.1)
source = replace(source, space=ParameterSpace((parameter,)))
ramp = RampSettings(phases=1).create(Problem(get_task("arm"), source))
ramp.move(None, None)
print(ramp.distribution.low, ramp.distribution.high)
"""
# the file beside ours, in a folder that the package is extended by
ADD_FILE = """
import adr_service.methods
adr_service.methods.__path__.append({folder!r})
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
    (source / "ramp.py").write_text(block("python", "class Ramp:"))
    (source / "pyproject.toml").write_text(block("toml", "entry-points"))
    install(source, folder)
    return folder


def test_an_installed_method_is_planned_run_and_reported(installed):
    done = python(USE, installed)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "adr-random-search 0.1.0"


@pytest.mark.slow
def test_an_installed_curriculum_is_planned_and_trained_on(installed):
    done = python(USE_RAMP, installed)
    assert done.returncode == 0, done.stderr
    space = source_of("arm", "vanilla").space
    assert float(done.stdout) == pytest.approx(space.high[0] - space.low[0], abs=1e-3)


def test_rounding_leads_the_installed_curriculum_no_further_than_the_search_range(installed):
    done = python(LAST_RAMP, installed)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[0.1] [0.4]"


@pytest.mark.slow
def test_one_file_in_the_package_is_planned_run_and_reported(tmp_path):
    (tmp_path / "random_search.py").write_text(block("python", "class RandomSearch:"))
    done = python(ADD_FILE.format(folder=str(tmp_path)) + USE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "None"


def test_the_page_can_be_followed_word_for_word(installed, tmp_path):
    (tmp_path / "try_it.py").write_text(block("python", "simulate_rollout"))
    done = python((tmp_path / "try_it.py").read_text(), installed)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() in PAGE


def test_a_method_can_be_imported_before_anything_of_ours(installed):
    done = python("import random_search; import adr_service.specs", installed)
    assert done.returncode == 0, done.stderr


def test_a_method_that_takes_one_of_our_names_is_refused_with_the_names(tmp_path):
    (tmp_path / "mine.py").write_text(
        block("python", "class RandomSearch:").replace('"random_search"', '"dropo"')
    )
    add_entry_point(tmp_path, "adr_service.methods", "mine:RandomSearchSettings", name="dropo")
    done = python("import adr_service.specs", tmp_path)
    assert "gives a method whose name is taken; the other methods are auto_dr, " in done.stderr


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("adr_service.methods.base:OfflineSettings", "which lacks create, planned_steps"),
        ("nowhere:Settings", "cannot be loaded"),
        ("adr_service.methods.udr:UdrSettings", "a subclass of OfflineSettings, "),
        ("random_search:RandomSearchSettings", "a method of another name, 'random_search'"),
    ],
)
def test_a_wrong_entry_point_is_refused_with_its_name(installed, tmp_path, value, message):
    add_entry_point(tmp_path, "adr_service.methods", value)
    done = python("import adr_service.specs", tmp_path, installed)
    assert message in done.stderr
    assert "'broken'" in done.stderr


# of types that JSON lacks, beside one whose default JSON keeps and one without a default
ODD_SETTINGS = """
from enum import Enum
from pathlib import Path
from typing import Literal

from pydantic import model_validator

from adr_service.methods.base import CurriculumSettings

class Shape(Enum):
    BOX = "box"

class OddSettings(CurriculumSettings):
    name: Literal["broken"] = "broken"
    width: float
    count: int = 3
{odd}

    def create(self, problem):
        raise NotImplementedError
"""
ODD = """
    sizes: tuple[int, int] = (3, 4)
    shape: Shape = Shape.BOX
    kinds: set[str] = {"one"}
    folder: Path = Path("data")
"""


def imported_with(odd, folder):
    """A process that imports us beside a package with `ODD_SETTINGS`."""
    (folder / "odd.py").write_text(ODD_SETTINGS.format(odd=odd))
    add_entry_point(folder, "adr_service.methods", "odd:OddSettings")
    return python("import adr_service.specs", folder)


def test_settings_that_cannot_be_read_from_the_json_of_their_defaults_are_refused(tmp_path):
    done = imported_with(ODD, tmp_path)
    assert "whose defaults cannot be read from their JSON: sizes: Input should be" in done.stderr
    assert all(f"; {name}: Input should be" in done.stderr for name in ("shape", "kinds", "folder"))
    assert "width" not in done.stderr.splitlines()[-1]
    assert "count" not in done.stderr.splitlines()[-1]


CHOICE = """
    share: float | None = None

    @model_validator(mode="after")
    def _has_one(self):
        if self.share is None:
            raise ValueError("give a share")
        return self
"""


@pytest.mark.parametrize("more", ["", CHOICE], ids=["a field", "a choice"])
def test_settings_that_need_something_given_are_accepted(tmp_path, more):
    done = imported_with(more, tmp_path)
    assert done.returncode == 0, done.stderr

"""Settings that are common to methods, and the problem that a method may see."""

import ast
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
from pydantic import Field, ValidationError

from adr_service import methods
from adr_service.errors import InvalidInput
from adr_service.methods.base import Data, Grid, MethodSettings, OfflineSettings
from adr_service.methods.simopt import SimOptSettings

METHODS = Path(methods.__file__).parent


class GridSettings(MethodSettings):
    name: Literal["gridded"] = "gridded"
    width: float | list[float] = Field([1.0, 2.0, 3.0])
    depth: int = 5

    grid: ClassVar[Grid | None] = Grid("width", criterion="error")


class TestEach:
    def test_a_list_is_expanded_in_its_order(self):
        assert [one.width for one in GridSettings().each] == [1.0, 2.0, 3.0]

    def test_other_settings_stay_as_they_are(self):
        assert [one.depth for one in GridSettings(depth=7).each] == [7, 7, 7]

    def test_one_value_is_a_grid_of_one(self):
        assert GridSettings(width=4.0).each == [GridSettings(width=4.0)]

    def test_settings_without_a_grid_stand_for_themselves(self):
        assert SimOptSettings().each == [SimOptSettings()]


class TestTheBestOfAGrid:
    grid = Grid("width", criterion="error")

    def test_the_smallest_criterion_is_best(self):
        assert self.grid.best([3.0, 1.0, 2.0]) == 1

    def test_of_criteria_within_a_hundredth_the_first_is_best(self):
        assert self.grid.best([3.381e-4, 3.375e-4, 1e-3]) == 0
        assert self.grid.best([3.5e-4, 3.375e-4, 1e-3]) == 1

    def test_an_answer_that_predicts_nothing_is_never_best(self):
        assert self.grid.best([np.nan, np.inf, None, 2.0, -np.inf]) == 3

    def test_criteria_may_be_negative(self):
        assert self.grid.best([-1.0, -3.0, -3.01]) == 1

    def test_without_a_finite_criterion_there_is_no_best(self):
        with pytest.raises(InvalidInput, match=r"no width gives .* error is one of \[nan, nan\]"):
            self.grid.best([np.nan, np.nan])


@pytest.mark.parametrize(
    ("data", "infers"),
    [("nothing", False), ("returns", False), ("visits", True), ("recordings", True)],
)
def test_methods_that_learn_from_transitions_infer(data, infers):
    class Settings(MethodSettings):
        name: Literal["any"] = "any"
        learns_from: ClassVar[Data] = data

    assert Settings().infers == infers


def test_class_variables_are_no_settings():
    assert set(GridSettings.model_fields) == {"name", "width", "depth"}
    with pytest.raises(ValidationError, match="no field 'label'"):
        GridSettings.model_validate({"label": "Mine"})


def test_offline_settings_must_make_a_method_and_plan_its_steps():
    assert OfflineSettings.__abstractmethods__ == {"create", "planned_steps"}


@pytest.mark.parametrize("path", sorted(METHODS.glob("*.py")), ids=lambda path: path.name)
def test_no_method_reads_a_tasks_model_file(path):
    """It has the truth; what a method may simulate is the source."""
    nodes = ast.walk(ast.parse(path.read_text()))
    read = [node.attr for node in nodes if isinstance(node, ast.Attribute)]
    assert not {"xml", "hidden", "variants"} & set(read)

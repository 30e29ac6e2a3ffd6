"""Criticisms as stages: their files, and that equal ones are equal to the byte."""

import json
from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.planting import draw_case
from adr_service.criticism.report import FILES
from adr_service.errors import InvalidInput
from adr_service.npz import write_arrays
from adr_service.stages.base import compute
from adr_service.stages.criticise import Criticise
from tests.hidden import arm, recorded

pytestmark = pytest.mark.slow  # tests/api/routes/test_criticisms.py computes one too


@pytest.fixture(scope="module")
def stage():
    """A criticism of an arm that hides one effect."""
    case = draw_case(*arm(), np.random.default_rng(100), 0.3)
    data = write_arrays(recorded(case.measurement.episodes(range(8))))
    return Criticise(task="arm", variant="vanilla", seed=0, data=data)


@pytest.fixture(scope="module")
def result(stage):
    return stage.read(compute(stage))


def test_its_files_are_those_of_a_report(result):
    assert set(result.files) <= set(FILES)
    assert {"verdict.json", "report.html"} <= set(result.files)


def test_its_verdict_is_the_one_in_the_file_without_the_time_that_it_took(result):
    assert json.loads(result.files["verdict.json"]) == result.verdict
    assert result.verdict["seconds"] is None


def test_it_is_the_same_to_the_byte_when_it_is_computed_again(stage, result):
    assert stage.read(compute(stage)) == result


def test_its_report_names_the_task_and_the_variant(result):
    assert b"arm, vanilla" in result.report


def test_data_that_are_no_measurement_are_refused(stage):
    with pytest.raises(InvalidInput, match=r"not a readable \.npz"):
        compute(replace(stage, data=b"measured"))


def test_a_stand_in_has_no_extended_model_and_differs_by_digest(stage):
    stand_in, other = stage.stand_in(), replace(stage, seed=1).stand_in()
    assert set(stand_in.files) == {"verdict.json", "report.html"}
    assert stand_in.files["verdict.json"] != other.files["verdict.json"]

"""`adr criticise`, from files to files."""

import json

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from adr_service.blind_test.planting import draw_case
from adr_service.tasks.catalogue import get_task
from api.cli import app
from tests.hidden import arm, recorded


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The file of a measurement that hides an effect, short to be fast."""
    hidden = draw_case(*arm(), np.random.default_rng(100), 0.3)
    path = tmp_path_factory.mktemp("data") / "arm.npz"
    np.savez(path, **recorded(hidden.measurement.episodes(range(8))))
    return path


def run(*arguments):
    return CliRunner().invoke(app, ["criticise", *map(str, arguments)])


def test_a_task_and_a_measurement_give_verdict_report_and_extended_model(data, tmp_path):
    done = run("--task", "arm", "--data", data, "--out", tmp_path)
    assert done.exit_code == 0, done.output
    verdict = json.loads((tmp_path / "verdict.json").read_text())
    assert verdict["version"] == 1
    assert verdict["verdict"] in ("cause", "tie")
    first = verdict["causes"][0]
    assert first["kind"] in done.output
    assert {"value", "low", "high", "unit"} == set(next(iter(first["parameters"].values())))
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "extended.xml")).nv == 2
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == 5
    assert "The simulator lacks" in page


@pytest.mark.slow  # tests/test_docs.py criticises a model of its own, too
def test_a_model_of_ones_own_has_the_parameters_that_were_set_free(data, tmp_path):
    model = tmp_path / "arm.xml"
    model.write_text(get_task("arm").xml)
    free = ["--free", "joint:elbow.damping=0:8", "--free", "body:fore.inertial=0.1:5"]
    done = run("--model", model, *free, "--data", data, "--out", tmp_path)
    assert done.exit_code == 0, done.output
    moved = json.loads((tmp_path / "verdict.json").read_text())["residual"]["parameters"]
    assert list(moved) == ["joint:elbow.damping", "body:fore.inertial"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either --task or --model"),
        (["--task", "arm", "--free", "x=0:1"], "--free goes with --model"),
        (["--model", "nowhere.xml"], "nowhere.xml cannot be read"),
    ],
)
def test_wrong_arguments_are_refused_with_what_is_accepted(data, tmp_path, arguments, message):
    done = run(*arguments, "--data", data, "--out", tmp_path)
    assert done.exit_code != 0
    assert message in str(done.exception) + done.output

"""The example package of docs/own-task.md, installed and used."""

import subprocess

import pytest

from tests.packages import ROOT, add_entry_point, install, python

EXAMPLE = ROOT / "docs/examples/adr-pendulum"

USE = """
import gymnasium, numpy as np
from adr_service.stages.local import LocalStages
from adr_service.programs import run
from adr_service.simulation.batch import Simulations
from adr_service.specs import RunSpec
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, source_of, variants_of
from tests.plain import model_of
import mujoco

task = get_task("pendulum")
assert list(variants_of("pendulum")) == ["vanilla", "noisy", "unmodeled", "edge", "outside"]

source = source_of("pendulum", "vanilla")
draw = np.array([0.7, 0.2, 1.6])
simulations = Simulations(task, source, 1)
simulations.set_dynamics(draw[None])
simulations.set_state(State(np.array([[0.3]]), np.array([[0.0]])))
model = model_of(task, source, draw)
data = mujoco.MjData(model)
data.qpos[:] = 0.3
for _ in range(50):
    simulations.step(np.array([0.5]))
    data.ctrl[:] = 0.5
    mujoco.mj_step(model, data, 2)
assert simulations.state.qpos[0, 0] == data.qpos[0]

spec = RunSpec.model_validate({
    "task": "pendulum", "preset": "smoke", "method": {"name": "simopt", "samples": 10}})
stages = LocalStages()
events = list(run(spec, stages))
assert events[-1].iteration == spec.iterations
assert all(s.inputs["package"] == "adr-pendulum 0.1.0" for s in stages.executed), stages.executed
print("fine")
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder to import the example from."""
    folder, copy = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("source") / "example"
    subprocess.run(["cp", "-r", str(EXAMPLE), str(copy)], check=True)
    install(copy, folder)
    return folder


def test_an_installed_task_is_simulated_and_runs(installed):
    done = python(USE, installed)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "fine"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("nowhere:ENTRY", "cannot be loaded"),
        ("adr_service.tasks.hopper:Hopper", "must name an adr_service.tasks.base.Entry"),
        ("adr_pendulum:ENTRY", "a task of another name, 'pendulum'"),
    ],
)
def test_a_broken_entry_point_is_named_with_its_error(installed, tmp_path, value, message):
    add_entry_point(tmp_path, "adr_service.tasks", value)
    code = "from adr_service.tasks.catalogue import get_task; get_task('arm')"
    done = python(code, tmp_path, installed)
    assert message in done.stderr
    assert "'broken'" in done.stderr

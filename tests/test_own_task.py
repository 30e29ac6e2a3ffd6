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
# a benchmark of the package's first version, in a database
FILL = """
import pickle, sys
from dataclasses import replace

from adr_service.tasks.catalogue import task_inputs
from db.session import open_database
from tests.db.finished import finished_benchmark
from tests.stages.examples import evaluation

id = finished_benchmark(open_database({url!r}), tasks=["pendulum", "arm"], methods=["simopt"])
with open({stage!r}, "wb") as file:
    pickle.dump(replace(evaluation(task="pendulum"), **task_inputs("pendulum")), file)
print(id)
"""
# what a service of the next version answers
LOOK = """
import pickle

from adr_service.errors import AdrError
from adr_service.stages.base import compute
from api.page import benchmarks as benchmark_pages, runs as run_pages
from api.routes import benchmark_results, benchmarks, run_results
from db import benchmarks as store
from db.session import open_database
from tests.api.standins import Service

database = open_database({url!r})
client = Service(database).client(
    *(benchmark_pages.router, run_pages.router),
    *(benchmark_results.router, benchmarks.router, run_results.router),
)
one, here = "{id}", "/v1/benchmarks/{id}"
found = client.get(here + "/results").json()
assert {{row["task"] for row in found["rows"]}} == {{"arm", "pendulum"}}
assert {{each["task"] for each in found["estimates"]}} == {{"arm"}}
for name in client.get(here + "/figures").json():
    assert client.get(f"{{here}}/figures/{{name}}.svg").status_code == 200, name
reason = found["note"].rpartition("; ")[2]
assert reason in client.get("/benchmarks/" + one).text
for run in store.runs_of(database, one):
    answer = client.get(f"/v1/runs/{{run.id}}/distribution")
    page = client.get(f"/runs/{{run.id}}")
    assert (answer.status_code, reason in page.text) == {{
        "arm": (200, False), "pendulum": (409, True)}}[run.spec.task], answer.text
    assert answer.status_code == 200 or answer.json()["detail"] in reason
extension = client.post(here + "/extend", json={{"seeds": [1]}})
print(reason)
print(extension.status_code, extension.json()["detail"].replace(one, "it"))
try:
    with open({stage!r}, "rb") as file:
        compute(pickle.load(file))
except AdrError as error:
    print(error)
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


def test_a_task_that_takes_one_of_our_names_is_refused(tmp_path):
    add_entry_point(tmp_path, "adr_service.tasks", "adr_service.tasks.hopper:ENTRY", name="hopper")
    done = python("from adr_service.tasks.catalogue import get_task; get_task('arm')", tmp_path)
    assert "gives a task 'hopper', but there is one already" in done.stderr


@pytest.mark.slow
def test_a_newer_version_shows_no_distributions_of_an_older_one_and_computes_none_of_its_stages(
    installed, tmp_path
):
    newer, source = tmp_path / "newer", tmp_path / "source"
    subprocess.run(["cp", "-r", str(EXAMPLE), str(source)], check=True)
    _change(source / "pyproject.toml", 'version = "0.1.0"', 'version = "0.2.0"')
    module = source / "adr_pendulum/__init__.py"
    mass, friction = _lines(module, 'Parameter("mass"', 'Parameter("friction"')
    _change(module, mass + friction, friction + mass)
    install(source, newer)
    places = {"url": f"sqlite:///{tmp_path / 'adr.sqlite'}", "stage": str(tmp_path / "stage")}
    filled = python(FILL.format(**places), installed)
    assert filled.returncode == 0, filled.stderr
    seen = python(LOOK.format(**places, id=filled.stdout.strip()), newer)
    assert seen.returncode == 0, seen.stderr
    assert seen.stdout.splitlines() == [
        "pendulum: computed with adr-pendulum 0.1.0, and adr-pendulum 0.2.0 is installed: install "
        "the former again to see its distributions",
        "422 it was computed with adr-pendulum 0.1.0, and adr-pendulum 0.2.0 is installed; submit "
        "it anew",
        "this process has adr-pendulum 0.2.0, the stage is of adr-pendulum 0.1.0: install "
        "one version everywhere, and start the service again",
    ]


def _lines(path, *starts):
    """The line of a file that begins with each of these."""
    lines = path.read_text().splitlines(keepends=True)
    return [next(line for line in lines if line.lstrip().startswith(start)) for start in starts]


def _change(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))

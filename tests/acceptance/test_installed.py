"""The wheel in an environment of its own, in a folder whose modules have our packages' names."""

import os
import subprocess
import sys

import pytest

from tests import robots
from tests.api.page.addresses import LISTS
from tests.packages import ROOT, build_wheel
from tests.service import start_service, wait_until_finished

pytestmark = [pytest.mark.slow, pytest.mark.ray]
NEIGHBOURS = ("api/__init__.py", "db.py", "workers.py")
ALONE = {"PYTHONPATH": ""}  # nothing leads to the checkout
EXTERNAL = {"task": "arm", "method": "simopt", "preset": "smoke", "target": {"kind": "external"}}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """`adr` of an environment that never saw the checkout; its packages come from the index."""
    folder = tmp_path_factory.mktemp("installed")
    wheel = build_wheel(folder)
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    pip = [folder / "venv/bin/pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt"]
    for package in ("torch==2.13.0", wheel):  # torch first: its build for CPUs
        subprocess.run([*pip, package], check=True, env={**os.environ, **ALONE})
    return folder / "venv/bin/adr"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("project")
    for name in NEIGHBOURS:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("raise RuntimeError('a neighbour was imported')\n")
    (folder / "my_robot.py").write_text(robots.MODULE)
    return folder


@pytest.fixture(scope="module")
def service(installed, folder, tmp_path_factory):
    data = tmp_path_factory.mktemp("data")
    with start_service(data, cpus=1, environment=ALONE, adr=[installed], cwd=folder) as running:
        yield running


@pytest.fixture
def adr(installed, folder, service):
    def run(*arguments):
        done = subprocess.run(
            [installed, *map(str, arguments)],
            cwd=folder,
            env={**os.environ, **ALONE, "ADR_URL": service.client.url},
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


def test_a_smoke_run_succeeds_and_every_page_is_there(adr, service):
    adr("submit", "--task", "arm", "--method", "simopt", "--preset", "smoke", "--watch")
    run = service.client.list_all("runs")[-1]
    assert run["state"] == "succeeded"
    files = ("style.css", "page.js", "vendor/htmx.min.js")
    for address in [*LISTS, f"/runs/{run['id']}", *(f"/static/{name}" for name in files)]:
        assert service.client.content(address)


def test_a_robot_of_the_folder_runs_its_episodes(adr, service):
    run = service.client.submit_run(EXTERNAL)
    adr("robot", "--task", "arm", "--env", "my_robot:make", "--episodes", 11)
    assert wait_until_finished(service.client, run["id"], 60)["state"] == "succeeded"


def test_the_demo_starts_a_service_of_its_own(adr, tmp_path):
    assert "returns.png" in adr("demo", "--data-dir", tmp_path / "demo")

"""The pages that newcomers follow: their commands and programs, in order, in a fresh directory."""

import re
import subprocess
import sys

import pytest

from tests import robots
from tests.packages import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.ray]
DOCS = ROOT / "docs"


@pytest.fixture
def folder(tmp_path, monkeypatch, service):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ADR_URL", service.client.url)
    return tmp_path


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)


def adr(line):
    """Run a line of a page; `adr` is that of this checkout."""
    words = line.partition("#")[0].split()
    assert words[0] == "adr", line
    command = [sys.executable, "-m", "api", *words[1:]]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, line + done.stdout + done.stderr
    return done.stdout


def test_getting_started(folder, service):
    _install, serve, submit, files = blocks("getting-started.md", "sh")
    assert serve.strip() == "adr serve"
    write, price, run = submit.strip().splitlines()
    subprocess.run(write, shell=True, check=True)  # noqa: S602 - our own page
    assert "environment steps" in adr(price)
    assert "dropo" in adr(run)
    benchmark = service.client.list_all("benchmarks")[-1]["id"]
    for line in files.strip().splitlines():
        adr(line.replace("<benchmark>", benchmark))
    assert (folder / "figures/returns.svg").exists()
    assert (folder / "report/index.html").exists()
    rows = service.client.results(benchmark)["rows"]
    returns = {row["method"]: row["normalised_return"] for row in rows}  # of the last iteration
    assert returns["dropo"] > 0.9 > 3 * returns["prior"], "the page tells another story"


def test_from_python(folder, service):
    study, robot = blocks("python.md", "python")
    values: dict = {}
    exec(study, values)  # noqa: S102 - our own page
    assert set(values["table"]["method"]) == {"dropo", "prior", "oracle"}
    (folder / "my_robot.py").write_text(robots.MODULE)
    spec = {"task": "arm", "method": "simopt", "preset": "smoke", "target": {"kind": "external"}}
    run = service.client.submit_run(spec)
    exec(robot, {})  # noqa: S102 - our own page
    assert service.client.wait(run["id"], progress=False)["state"] == "succeeded"

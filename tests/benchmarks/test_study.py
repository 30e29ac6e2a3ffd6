"""A study goes on from its archive on another machine."""

import csv
import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.ray
ROOT = Path(__file__).parents[2]
STUDY = {
    "first": {"tasks": ["arm"], "methods": ["sysid"], "seeds": [0], "preset": "smoke"},
    "then": [{"methods": ["udr"]}],
}


@contextmanager
def study(machine, folder):
    """The study, which runs in the working directory of a machine."""
    machine.mkdir()
    file = machine / "small.json"
    file.write_text(json.dumps(STUDY))
    with subprocess.Popen(
        [sys.executable, "-m", "benchmarks.study", str(file), str(folder)],
        cwd=machine,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        yield process
        assert process.wait(timeout=240) == 0


@pytest.mark.slow
def test_a_stopped_study_is_finished_on_another_machine(tmp_path):
    folder = tmp_path / "results"
    with study(tmp_path / "one", folder) as process:
        process.stdout.readline()  # it has begun
        os.killpg(process.pid, signal.SIGINT)  # as Ctrl-C does
    assert {path.name for path in folder.iterdir()} >= {"study.adr", "index.html", "results.csv"}
    (folder / "discussion.md").write_text("by hand")
    with study(tmp_path / "two", folder) as process:
        process.stdout.read()
    rows = list(csv.DictReader((folder / "results.csv").read_text().splitlines()))
    assert {row["method"] for row in rows} == {"sysid", "udr", "prior", "oracle"}
    assert "4 runs succeeded" in (folder / "index.html").read_text()
    assert (folder / "discussion.md").read_text() == "by hand"
    assert {path.name for path in folder.glob("*.adr")} == {"study.adr", "study-udr.adr"}
    assert folder.stat().st_mode & 0o777 == 0o755

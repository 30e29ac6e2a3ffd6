"""A study goes on from its archive on another machine."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.ray
ROOT = Path(__file__).parents[2]
STUDY = {
    "first": {"tasks": ["arm"], "methods": ["sysid"], "seeds": [0], "preset": "smoke"},
    "then": [{"methods": ["udr"]}],
}


def study(machine, folder, *options):
    """Run the study in the working directory of a machine."""
    machine.mkdir(exist_ok=True)
    file = machine / "small.json"
    file.write_text(json.dumps(STUDY))
    subprocess.run(
        [sys.executable, "-m", "benchmarks.study", str(file), str(folder), *options],
        cwd=machine,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=True,
        timeout=240,
    )


def test_a_stopped_study_is_finished_on_another_machine(tmp_path):
    folder = tmp_path / "results"
    study(tmp_path / "one", folder, "--hours", "0")
    assert {path.name for path in folder.iterdir()} >= {"study.adr", "index.html", "results.csv"}
    (folder / "discussion.md").write_text("by hand")
    study(tmp_path / "two", folder)
    rows = list(csv.DictReader((folder / "results.csv").read_text().splitlines()))
    assert {row["method"] for row in rows} == {"sysid", "udr", "prior", "oracle"}
    assert "4 runs succeeded" in (folder / "index.html").read_text()
    assert (folder / "discussion.md").read_text() == "by hand"

"""A study goes on from its archive on another machine."""

import csv
import json
import os
import signal
import subprocess
import sys
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import pytest

from adr_service.benchmark.archive import ArchiveReader
from adr_service.client import Unreachable
from adr_service.specs import BenchmarkExtension, BenchmarkPart, BenchmarkSpec
from benchmarks import study as study_module
from benchmarks.study import parts_of
from db.benchmarks import grid_of

ROOT = Path(__file__).parents[2]
STUDY = {
    "first": {"tasks": ["arm"], "methods": ["sysid"], "seeds": [0], "preset": "smoke"},
    "then": [{"methods": ["udr"]}],
}


def methods_in(path):
    """The methods of an archive's runs."""
    with path.open("rb") as file, ArchiveReader(file) as archive:
        return {row["method"] for row in archive.rows("runs")}


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


def test_each_run_of_a_study_is_in_an_archive_of_its_own():
    """References are in all of them."""
    study = {
        "first": {"tasks": ["arm"], "methods": ["sysid"], "seeds": [0, 1]},
        "then": [{"methods": ["udr", {"name": "dropo"}]}, {"variants": ["noisy"]}, {"seeds": [2]}],
    }
    parts = parts_of(study)
    assert list(parts) == ["study.adr", "study-udr-dropo.adr", "study-noisy.adr", "study-2.adr"]
    whole = BenchmarkSpec.model_validate(study["first"])
    for extension in study["then"]:
        whole = whole.extended(BenchmarkExtension.model_validate(extension))
    found = Counter(
        cell for part in parts.values() for cell in grid_of(whole.part(BenchmarkPart(**part)))
    )
    assert found.keys() == grid_of(whole).keys()
    assert {cell[2] for cell, count in found.items() if count > 1} == {"prior", "oracle"}


def test_an_extension_of_two_kinds_is_refused():
    """Its runs would be no grid, and an archive has a grid."""
    with pytest.raises(SystemExit, match="adds members of one kind"):
        parts_of({**STUDY, "then": [{"methods": ["udr"], "seeds": [1]}]})


@pytest.mark.parametrize("refusals", [0, 3])
def test_a_service_that_is_busy_is_asked_again(monkeypatch, refusals):
    """Once a study died because other work on its machine left it no time for five minutes."""
    monkeypatch.setattr(study_module, "_PAUSE_S", 0.0)
    answers = iter([Unreachable("busy")] * refusals)

    def ask(id):
        if (error := next(answers, None)) is not None:
            raise error
        return {"id": id}

    assert study_module.patiently(ask, "bench_a") == {"id": "bench_a"}


def test_a_service_that_never_answers_is_given_up(monkeypatch):
    monkeypatch.setattr(study_module, "_PAUSE_S", 0.0)
    monkeypatch.setattr(study_module, "_TRIES", 4)
    asked = []

    def ask():
        asked.append(1)
        raise Unreachable("gone")

    with pytest.raises(Unreachable, match="gone"):
        study_module.patiently(ask)
    assert len(asked) == 5


@pytest.mark.ray
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
    assert {path.name: methods_in(path) for path in folder.glob("*.adr")} == {
        "study.adr": {"sysid", "prior", "oracle"},
        "study-udr.adr": {"udr", "prior", "oracle"},
    }
    assert folder.stat().st_mode & 0o777 == 0o755

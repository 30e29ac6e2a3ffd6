"""The command line against a real service."""

import importlib.util
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console

from api import doctor
from tests.recordings import recording

pytestmark = pytest.mark.ray


@pytest.fixture
def adr(adr_here, service, tmp_path, monkeypatch):
    """Runs `adr` with these arguments against the service; gives exit status and output."""
    monkeypatch.setenv("ADR_URL", service.client.url)
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        code, out, told = adr_here(*arguments)
        assert bool(told) == (code == 2), told
        return code, out or told

    return run


def test_a_run_from_submission_to_its_files(adr, tmp_path):
    code, shown = adr(
        "submit", "--task", "arm", "--method", "simopt", "--preset", "smoke",
        "--set", "method.samples=10", "--set", "seed=3", "--watch",
    )  # fmt: skip
    assert code == 0
    id = shown.split()[0]
    assert "simopt" in shown
    _, status = adr("status", id)
    assert json.loads(status)["spec"]["method"]["samples"] == 10
    assert json.loads(status)["spec"]["seed"] == 3
    assert adr("watch", id)[0] == 0
    assert "return /" in adr("results", id)[1]
    assert adr("results", id, "--csv")[1].startswith("task,variant,method")
    assert "no two methods to compare" in adr("results", id, "--compare")[1]
    assert adr("results", id, "--figure", "returns.svg")[0] == 0
    assert adr("results", id, "--policy", "policy.safetensors") == (0, "policy.safetensors\n")
    assert (tmp_path / "returns.svg").read_bytes().startswith(b"<?xml")
    assert (tmp_path / "policy.safetensors").stat().st_size > 0
    assert id in adr("list")[1]


def test_a_benchmark_from_a_file_and_what_it_would_cost(adr, tmp_path):
    (tmp_path / "b.json").write_text(
        json.dumps({"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke"})
    )
    code, shown = adr("submit", "b.json", "--dry-run")
    assert code == 0
    assert re.search(r"trainings, shared ones once +4", shown)
    assert "less than a minute on a core" in shown
    assert json.loads(adr("submit", "b.json", "--dry-run", "--json")[1])["plan"]["trainings"] == 4


def test_a_recording_is_uploaded_and_learned_from(adr, tmp_path):
    data = recording("arm", 40)
    (tmp_path / "arm.npz").write_bytes(data.to_npz())
    code, shown = adr("upload", "arm.npz", "--task", "arm")
    assert code == 0
    dataset = shown.strip()
    assert dataset in adr("datasets")[1]
    options = ["--task", "arm", "--method", "droid", "--preset", "smoke", "--dataset", dataset]
    code, shown = adr("submit", *options, "--set", "target.episodes=1", "--watch")
    assert code == 0
    assert "upper_mass" in shown
    assert "mean nothing" in shown  # the smoke preset
    id = shown.split()[0]
    assert adr("results", id, "--distribution", "found.json")[0] == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert [p["unit"] for p in found["parameters"]][:2] == ["kg", "kg"]
    prefix = tmp_path / "dropo"
    arrays = (("observations", data.observations), ("actions", data.actions))
    arrays += (("nextobservations", data.next_observations), ("terminals", np.zeros(len(data))))
    for name, values in arrays:
        np.save(f"{prefix}_{name}.npy", values)
    assert adr("upload", "dropo", "--task", "arm")[1].startswith("data_")


def test_a_benchmark_is_extended_drawn_and_held_against_the_claims(adr, tmp_path):
    spec = {"tasks": ["arm"], "methods": ["sysid"], "seeds": [0], "preset": "smoke"}
    (tmp_path / "b.json").write_text(json.dumps({**spec, "references": False}))
    id = adr("submit", "b.json", "--watch")[1].split()[0]
    code, shown = adr("extend", id, "--method", "droid", "--watch")
    assert code == 0
    assert "droid" in shown
    assert adr("results", id, "--figures", "figures")[0] == 0
    drawn = {file.name for file in (tmp_path / "figures").iterdir()}
    assert {"returns.svg", "parameters.png", "spread.svg", "cost.csv"} <= drawn
    assert "nothing has been measured" in adr("claims", id)[1]  # smoke does not count
    assert "had ended before" in adr("cancel", id)[1]
    assert "has no run that failed or was cancelled" in adr("resume", id)[1]


def test_a_port_in_use_is_told_before_anything_starts(service, tmp_path):
    port = service.client.url.rpartition(":")[2]
    command = [sys.executable, "-m", "api", "serve", "--port", port, "--data-dir", "other"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False
    )
    assert done.returncode == 2
    assert "choose another with --port" in done.stderr
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["submit", "--task", "arm", "--method", "magic"], "accepted: udr, bayrn, simopt"),
        (["submit"], "either --task and --method, or a JSON file"),
        (["submit", "--task", "arm"], "either --task and --method, or a JSON file"),
        (["submit", "b.json", "--preset", "smoke"], "or a JSON file alone"),
        (["extend", "run_x", "--seed", "3"], "only a benchmark can be extended; given run_x"),
        (["results", "bench_x", "--policy", "p"], "no single policy"),
        (["upload", "text.txt", "--task", "arm"], "an .npz, or a prefix of .npy files"),
        (["submit", "nothing.json"], "not a readable JSON file"),
        (["submit", "--task", "arm", "--method", "udr", "--set", "seed"], "needs name=value"),
        (["status", "run_x"], "there is no run 'run_x'"),
        (["results", "bench_x"], "there is no benchmark 'bench_x'"),
        (["cancel", "run_x"], "there is no run"),
        (["upload", "none.npz", "--task", "arm"], "none.npz cannot be read"),
        (["upload", "none", "--task", "arm"], "none_*.npy cannot be read"),
        (["extend", "bench_x", "--seed", "3"], "there is no benchmark 'bench_x'"),
        (["claims", "bench_x"], "there is no benchmark 'bench_x'"),
    ],
)
def test_mistakes_are_explained_in_a_line_or_two(adr, arguments, message):
    code, shown = adr(*arguments)
    assert code == 2
    assert message in shown
    assert "Traceback" not in shown


def test_the_doctor_finds_this_machine_fit(adr):
    code, shown = adr("doctor")
    assert code == 0
    assert "MuJoCo simulates the tasks: arm, hopper" in shown


def test_the_doctor_tells_names_in_brackets_and_the_limit_on_connections(monkeypatch, capsys):
    """Rich takes `[fast]` for a style, and swallowed it."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(doctor, "_simulator", lambda: (True, "not asked here"))
    assert doctor.check(Console(width=200)) == 0
    shown = capsys.readouterr().out
    assert "pip install 'adr-service[fast]'" in shown
    assert "connections at once, the rest for Ray and the database" in shown

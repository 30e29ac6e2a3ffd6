"""The command line against a real service."""

import json
import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.ray


@pytest.fixture
def adr(service, tmp_path):
    """Runs `adr` with these arguments; gives exit status and output."""

    def run(*arguments):
        done = subprocess.run(
            [sys.executable, "-m", "api", *arguments],
            capture_output=True,
            text=True,
            timeout=120,
            cwd=tmp_path,
            env={**os.environ, "ADR_URL": service.client.url, "COLUMNS": "200"},
            check=False,
        )
        assert not done.stderr, done.stderr
        return done.returncode, done.stdout

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
    assert "95 % interval" in adr("results", id)[1]
    assert adr("results", id, "--csv")[1].startswith("task,variant,method")
    assert "no two methods to compare" in adr("results", id, "--compare")[1]
    assert adr("results", id, "--figure", "returns.svg")[0] == 0
    assert adr("results", id, "--policy", "policy.safetensors")[0] == 0
    assert (tmp_path / "returns.svg").read_bytes().startswith(b"<?xml")
    assert (tmp_path / "policy.safetensors").stat().st_size > 0
    assert id in adr("list")[1]


def test_a_benchmark_from_a_file_and_what_it_would_cost(adr, tmp_path):
    (tmp_path / "b.json").write_text(
        json.dumps({"tasks": ["arm"], "methods": ["udr"], "seeds": [0], "preset": "smoke"})
    )
    code, shown = adr("submit", "b.json", "--dry-run")
    assert code == 0
    assert json.loads(shown)["plan"]["trainings"] == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["submit", "--task", "arm", "--method", "magic"], "accepted: udr, bayrn, simopt"),
        (["submit"], "either a JSON file, or --task"),
        (["submit", "nothing.json"], "not a readable JSON file"),
        (["submit", "--task", "arm", "--method", "udr", "--set", "seed"], "needs name=value"),
        (["status", "run_x"], "there is no run 'run_x'"),
        (["results", "bench_x"], "there is no benchmark 'bench_x'"),
        (["cancel", "run_x"], "there is no run"),
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

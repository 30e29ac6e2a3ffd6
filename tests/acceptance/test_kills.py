"""kill -9 of working processes, and of Ray's own: nothing is lost, or done twice."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil
import pytest

from adr_service.client import AdrClient
from tests.acceptance.test_faults import committed, finished
from tests.service import RunningService, free_port, start_service, until, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]
BENCHMARK = {
    "tasks": ["arm"],
    "methods": ["simopt", {"name": "dropo", "budget": 30_000}],  # which takes a moment
    "seeds": [0],
    "preset": "smoke",
    "evaluation_episodes": 10_000,  # so that visits to the target take a moment
    "training": {"max_steps": 6000, "evaluate_every": 3000},
}
LONG = {
    "task": "arm",
    "method": "prior",
    "preset": "smoke",
    "training": {"max_steps": 10_000_000, "stop_at_threshold": False},
}
WORK = {"trainer": {"train_policy"}, "inference": {"infer"}, "target": {"evaluate"}}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    return undisturbed(tmp_path_factory.mktemp("whole"))


def undisturbed(folder: Path) -> tuple[str, set[str]]:
    """The result table, and the digests of all stages, of the benchmark on one node."""
    with start_service(folder, cpus=2) as running:
        id = running.client.submit_benchmark(BENCHMARK)["id"]
        wait_until_finished(running.client, id, 240)
        return running.client.results_csv(id), committed(folder)


@pytest.mark.parametrize("victim", ["trainer", "inference", "target", "board", "raylet", "gcs"])
def test_a_process_that_is_killed_costs_its_stage_alone(tmp_path, uninterrupted, victim):
    table, stages = uninterrupted
    with start_service(tmp_path, cpus=2) as running:
        id = running.client.submit_benchmark(BENCHMARK)["id"]
        pid = until(lambda: pid_of(running, id, victim))
        before = committed(tmp_path)
        os.kill(pid, signal.SIGKILL)
        final = wait_until_finished(running.client, id, 600)
        assert final["states"] == {"succeeded": 4}
        assert running.client.results_csv(id) == table
        attempts = running.attempts
    lost = len(stages - committed(tmp_path)) + len(finished(tmp_path) - committed(tmp_path))
    twice = sum(digest in before for digest, number in attempts if number > 1)
    again = sorted({number for _, number in attempts})
    report = f"killed {victim}: runs completed 4, stages lost {lost}, committed twice {twice}"
    sys.stderr.write(f"{report}, attempts {again}\n")
    assert (lost, twice) == (0, 0)
    assert again == ([1] if victim == "gcs" else [1, 2]) or victim == "board"


def test_processes_of_ray_that_are_killed_at_random_moments_change_nothing(tmp_path, uninterrupted):
    """Also while Ray starts again; of those, the death of a raylet alone costs an attempt."""
    table, stages = uninterrupted
    rng = np.random.default_rng(0)
    with start_service(tmp_path, cpus=2) as running:
        id = running.client.submit_benchmark(BENCHMARK)["id"]
        until(lambda: working(running.client, id, WORK["trainer"]))
        for victim in rng.permutation(["gcs", "gcs", "gcs", "gcs", "board", "raylet"]):
            os.kill(until(lambda name=victim: pid_of_ray(running, name)), signal.SIGKILL)
            time.sleep(rng.uniform(0, 4))
        final = wait_until_finished(running.client, id, 600)
        assert final["states"] == {"succeeded": 4}
        assert running.client.results_csv(id) == table
        assert {number for _, number in running.attempts} == {1, 2}
    assert committed(tmp_path) == stages


def test_a_service_whose_parent_is_process_1_outlives_its_raylet(tmp_path):
    port = free_port()
    log, serve = tmp_path / "service.log", [sys.executable, "-m", "api", "serve", "--no-dashboard"]
    given = ["--cpus", "1", "--port", str(port), "--data-dir", str(tmp_path)]
    leave = f'"$@" >{log} 2>&1 & echo $!'  # as a daemon; systemd's services are such too
    begun = subprocess.run(
        ["sh", "-c", leave, "sh", *serve, *given], capture_output=True, check=True
    )
    pid = int(begun.stdout)
    status = Path(f"/proc/{pid}/status")
    try:
        if "PPid:\t1\n" not in status.read_text():
            pytest.skip("orphans have another parent than process 1 here")
        with AdrClient(f"http://127.0.0.1:{port}") as client:
            until(lambda: "startup complete" in log.read_text())
            found = Path(f"/proc/{pid}/task").glob("*/children")
            children = [child for path in found for child in path.read_text().split()]
            (raylet,) = [c for c in children if Path(f"/proc/{c}/comm").read_text() == "raylet\n"]
            os.kill(int(raylet), signal.SIGKILL)
            until(lambda: "Ray has died" in log.read_text())
            run = client.submit_run({"task": "arm", "method": "prior", "preset": "smoke"})["id"]
            assert wait_until_finished(client, run, 240)["state"] == "succeeded"
    finally:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
        until(lambda: not status.exists() or "State:\tZ" in status.read_text())


def test_what_a_killed_service_leaves_running_is_ended_by_the_next(tmp_path):
    """Ray's agents outlive their raylet, and so does a worker that is stopped."""
    with start_service(tmp_path, cpus=1) as running:
        run = running.client.submit_run(LONG)["id"]
        pid = until(lambda: next((p["pid"] for p in running.client.get(run)["progress"]), None))
        os.kill(pid, signal.SIGSTOP)
        ours = set(running.children) | {pid}
        running.kill()
    with start_service(tmp_path, cpus=1) as running:
        left = {pid for pid in ours if psutil.pid_exists(pid)}
        assert not {psutil.Process(pid).name() for pid in left}
        assert len(list((tmp_path / "ray").glob("session_2*"))) == 1
        running.client.cancel(run)
        wait_until_finished(running.client, run, 120)


def pid_of(running: RunningService, benchmark: str, victim: str) -> int | None:
    """A process to kill: one that is at work on a stage of a kind, or one of Ray's own."""
    if victim in WORK:
        return working(running.client, benchmark, WORK[victim])
    if not working(running.client, benchmark, WORK["trainer"]):
        return None
    return pid_of_ray(running, victim)


def pid_of_ray(running: RunningService, victim: str) -> int | None:
    """One of Ray's own processes."""
    title = {"board": "ray::Board", "raylet": "raylet/raylet", "gcs": "gcs/gcs_server"}[victim]
    found = [pid for pid, name in running.children.items() if title in name]
    return found[0] if found else None


def working(client: AdrClient, benchmark: str, kinds: set[str]) -> int | None:
    progress = [s for run in client.get(benchmark)["runs"] for s in run["progress"]]
    pids = [s["pid"] for s in progress if s["kind"] in kinds and s["state"] == "running"]
    return next((pid for pid in pids if pid is not None), None)

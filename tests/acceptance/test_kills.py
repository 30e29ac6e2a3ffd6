"""kill -9 of every kind of process, in the middle of its work: nothing is lost, or done twice."""

import os
import re
import signal
import sys
import time

import pytest

from api.client import AdrClient
from tests.acceptance.test_faults import committed, finished
from tests.service import RunningService, start_service, wait_until_finished

pytestmark = [pytest.mark.ray, pytest.mark.slow]
BENCHMARK = {
    "tasks": ["arm"],
    "methods": ["simopt", {"name": "dropo", "budget": 30_000}],  # which takes a moment
    "seeds": [0],
    "preset": "smoke",
    "evaluation_episodes": 10_000,  # so that visits to the target take a moment
    "training": {"max_steps": 6000, "evaluate_every": 3000},
}
WORK = {"trainer": {"train_policy"}, "inference": {"infer"}, "target": {"evaluate"}}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The result table, and the digests of all stages, of a benchmark that nobody disturbs."""
    folder = tmp_path_factory.mktemp("whole")
    with start_service(folder, cpus=2) as running:
        id = running.client.submit_benchmark(BENCHMARK)["id"]
        wait_until_finished(running.client, id, 240)
        return running.client.results_csv(id), committed(folder)


@pytest.mark.parametrize("victim", ["trainer", "inference", "target", "board", "raylet"])
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
        attempts = re.findall(r"stage \w+ (\w{64}): attempt (\d)", running.log.read_text())
    lost = len(stages - committed(tmp_path)) + len(finished(tmp_path) - committed(tmp_path))
    twice = sum(digest in before for digest, number in attempts if number != "1")
    again = sorted({int(number) for _, number in attempts})
    report = f"killed {victim}: runs completed 4, stages lost {lost}, committed twice {twice}"
    sys.stderr.write(f"{report}, attempts {again}\n")
    assert (lost, twice) == (0, 0)
    assert victim == "board" or again == [1, 2]


def pid_of(running: RunningService, benchmark: str, victim: str) -> int | None:
    """A process to kill: one that is at work on a stage of a kind, or one of Ray's own."""
    if victim in WORK:
        return working(running.client, benchmark, WORK[victim])
    if not working(running.client, benchmark, WORK["trainer"]):
        return None
    title = {"board": "ray::Board", "raylet": "raylet/raylet"}[victim]
    found = [pid for pid, name in running.children.items() if title in name]
    return found[0] if found else None


def working(client: AdrClient, benchmark: str, kinds: set[str]) -> int | None:
    progress = [s for run in client.get(benchmark)["runs"] for s in run["progress"]]
    pids = [s["pid"] for s in progress if s["kind"] in kinds and s["state"] == "running"]
    return next((pid for pid in pids if pid is not None), None)


def until(condition, seconds=120):
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)
    return found

"""`adr tune`: a search over settings on Ray Tune, as a user runs it, and how it ranks."""

import json
import signal
import subprocess
import sys
from dataclasses import replace

import psutil
import pytest

from tests.service import children_of, until
from tests.training.examples import TINY  # a training of a second
from workers.tuning import Trial, candidates

# `adr`, also where these tests run in the background, which ignores interrupts
_INTERRUPTIBLE = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from api.cli import main
main()
"""
TRIAL = Trial(
    changes={"epochs": 5},
    seed=0,
    steps=1000,
    cpu_seconds=50.0,
    best_return=10.0,
    reached_threshold=True,
    stopped_early=False,
)


@pytest.mark.ray
@pytest.mark.slow
def test_every_combination_and_seed_is_tried():
    given = {**TINY, "algorithm": "sac", "backend": "sb3"}
    settings = [
        argument
        for name, value in given.items()
        for argument in ("--set", f"training.{name}={json.dumps(value)}")
    ]
    command = [sys.executable, "-m", "api", "tune", "arm", "--seeds", "2", "--cpus", "2", "--json"]
    command += ["--over", "learning_rate=[0.001,0.01]", "--over", 'activation=["relu"]']
    done = subprocess.run(
        [*command, *settings], capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stderr
    trials = json.loads(done.stdout)
    tried = {(trial["changes"]["learning_rate"], trial["seed"]) for trial in trials}
    assert tried == {(0.001, 1000), (0.001, 1001), (0.01, 1000), (0.01, 1001)}
    assert {trial["changes"]["activation"] for trial in trials} == {"relu"}
    assert {trial["steps"] for trial in trials} == {480}
    assert all(trial["cpu_seconds"] > 0 and not trial["stopped_early"] for trial in trials)


@pytest.mark.ray
@pytest.mark.slow
def test_an_interrupted_search_ends_with_all_its_processes():
    command = [sys.executable, "-c", _INTERRUPTIBLE, "tune", "arm", "--cpus", "2"]
    command += ["--over", "learning_rate=[0.001,0.01]"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as search:
        try:
            until(lambda: any("train" in title for title in children_of(search.pid).values()))
            started = children_of(search.pid)
            search.send_signal(signal.SIGINT)
            assert search.wait(timeout=60) == 130
        finally:
            search.kill()  # nothing, if it has ended
    until(lambda: not any(psutil.pid_exists(pid) for pid in started), seconds=30)


def test_candidates_that_reach_the_threshold_most_often_and_soonest_come_first():
    missed = {"reached_threshold": False}
    often = [replace(TRIAL, changes={"epochs": 10}, seed=seed) for seed in range(3)]
    sooner = [replace(TRIAL, seed=0, cpu_seconds=9.0), replace(TRIAL, seed=1, **missed)]
    better = [replace(TRIAL, changes={"epochs": 1}, best_return=20.0, **missed)]
    worse = [replace(TRIAL, changes={"epochs": 2}, best_return=15.0, **missed)]
    failed = [replace(TRIAL, changes={"epochs": 3}, best_return=None, **missed)]
    found = candidates([*failed, *worse, *sooner, *better, *often])
    assert [each.changes["epochs"] for each in found] == [10, 5, 1, 2, 3]
    assert [each.reached for each in found] == [3, 1, 0, 0, 0]
    assert found[1].cpu_seconds == [9.0]

"""`adr tune`: a search over learning rates on Ray Tune, as a user runs it."""

import json
import subprocess
import sys

import pytest

from tests.training.examples import TINY  # a training of a second


@pytest.mark.ray
@pytest.mark.slow
def test_every_rate_and_seed_is_tried_and_the_best_comes_first():
    given = {**TINY, "backend": "sb3"}
    settings = [
        argument
        for name, value in given.items()
        for argument in ("--set", f"training.{name}={json.dumps(value)}")
    ]
    command = [sys.executable, "-m", "api", "tune", "arm", "--rates", "0.001,0.01", "--seeds", "2"]
    command += ["--cpus", "2", "--json", *settings]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    trials = json.loads(done.stdout)
    tried = {(trial["learning_rate"], trial["seed"]) for trial in trials}
    assert tried == {(0.001, 0), (0.001, 1), (0.01, 0), (0.01, 1)}
    returns = [trial["best_return"] for trial in trials]
    assert returns == sorted(returns, reverse=True)
    assert {trial["steps"] for trial in trials} <= {240, 480}
    assert not any(trial["stopped_early"] and trial["steps"] == 480 for trial in trials)

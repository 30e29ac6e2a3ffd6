"""From a first recording to a second that a plan asks for, by the command line alone."""

import os
import subprocess
import sys

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.measurements import Measurement
from adr_service.npz import write_arrays
from benchmarks.separation import held
from tests.hidden import arm

ROBOT = """
import adr_service, gymnasium

def make():
    return gymnasium.make("adr/RandomArm-v0")
"""


@pytest.fixture
def first(tmp_path, monkeypatch):
    """A poor recording of an arm without any effect, and the robot, in the working directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "an_arm_of_a_test.py").write_text(ROBOT)
    rng = np.random.default_rng(5)
    name = os.fsdecode(b"f\xe4st.npz")  # no UTF-8, as on an old disk
    (tmp_path / name).write_bytes(hide(*arm(), rng, [], commands=held(rng)).to_npz())
    return name


@pytest.mark.slow
def test_a_plan_is_played_and_judged_together_with_the_first_recording(adr_here, first, tmp_path):
    judge = ["criticise", "--task", "arm", "--data", first, "--out", "found"]
    limits = ["--limit", "shoulder=-0.8:0.8", "--reach", "elbow=-2:2"]
    status, shown, errors = adr_here(*judge, "--next", "next.npz", *limits)
    assert status == 0, errors
    assert "next.npz: commands of 12 episodes, 1.5 s each" in shown
    assert "shoulder: " in shown
    assert " as recorded" in shown
    play = ["--task", "arm", "--env", "an_arm_of_a_test:make", "--out", "second.csv"]
    status, _, errors = adr_here("robot", "--play", "next.npz", *play)
    assert (status, "ends on .npz; given second.csv" in errors) == (2, True)
    play[-1] = "second.npz"
    status, shown, errors = adr_here("robot", "--play", "next.npz", *play, "--max-action", "0.5")
    assert status == 0, errors
    assert "second.npz: 12 of 12 episodes" in shown
    assert "commands were beyond your limit, and were sent at it" in shown
    status, _, errors = adr_here("robot", "--play", "next.npz", *play)
    assert (status, "second.npz is there already" in errors) == (2, True)
    status, _, errors = adr_here(*judge[:-1], "both", "--data", "second.npz")
    assert status == 0, errors
    assert (tmp_path / "both/verdict.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--limit", "shoulder=-1:1"], "--limit, --reach and --start go with --next"),
        (["--next", "next.npz", "--reach", "elbo=-1:1"], "did you mean 'elbow'"),
        (["--next", "next.npz", "--reach", "elbow=1:-1"], "the lower bound comes first"),
        (["--next", "next.npz", "--limit", "sholder=-1:1"], "did you mean 'shoulder'"),
        (["--next", "next.npz", "--limit", "shoulder=1"], "is not NAME=LOW:HIGH"),
        (["--next", "next.npz", "--limit", "shoulder"], "'shoulder' is not NAME=LOW:HIGH"),
        (["--next", "next.npz", "--limit", "-0.5:0.5"], "'-0.5:0.5' is not NAME=LOW:HIGH"),
        (["--next", "next.npz", "--limit", "shoulder=-5:5"], "shoulder obeys commands from -1"),
        (["--next", "next.npz", "--start", "shoulder"], "is not NAME=POSITION"),
        (["--next", "next.npz", "--start", "elbo=1"], "did you mean 'elbow'"),
        (["--next", "next.npz", "--start", "elbow=nan"], "is not finite"),
    ],
)
def test_wrong_limits_are_refused_before_the_work(adr_here, first, arguments, message):
    status, _, errors = adr_here(
        "criticise", "--task", "arm", "--data", first, "--out", "found", *arguments
    )
    assert status == 2
    assert message in errors


STUCK = """
import time
import adr_service
import gymnasium

class Stuck(gymnasium.Wrapper):
    episodes = 0

    def reset(self, **options):
        self.episodes += 1
        return super().reset(**options)

    def step(self, action):
        time.sleep(600 if self.episodes == 3 else 0)
        return super().step(action)

def make():
    return Stuck(gymnasium.make("adr/RandomArm-v0"))
"""


def test_a_robot_that_hangs_ends_the_command_with_what_was_played(tmp_path):
    (tmp_path / "stuck.py").write_text(STUCK)
    plan = {"time": np.tile(0.02 * np.arange(8), 4), "ctrl": np.zeros((32, 2))}
    plan["episode"] = np.repeat(np.arange(4), 8)
    (tmp_path / "plan.npz").write_bytes(write_arrays(plan))
    known = ["robot", "--task", "arm", "--env", "stuck:make", "--max-seconds", "0.2"]
    command = [sys.executable, "-m", "api", *known, "--play", "plan.npz", "--out", "played.npz"]
    ended = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert ended.returncode == 1
    assert "the environment's step did not return" in ended.stdout
    assert "played.npz: 2 of 4 episodes, 16 rows" in ended.stdout
    played = Measurement.from_npz((tmp_path / "played.npz").read_bytes())
    assert [last - first for first, last in played.spans()] == [8, 8]


def test_options_that_play_does_not_obey_are_refused(adr_here, first):
    known = ["robot", "--task", "arm", "--env", "an_arm_of_a_test:make", "--play", first]
    for more, message in (
        ([], "--play goes with --out"),
        (["--out", "a", "--episodes", "1"], "--ep"),
        (["--out", "a", "--url", "http://127.0.0.1:1"], "--url go without --play"),
    ):
        status, _, errors = adr_here(*known, *more)
        assert (status, message in errors) == (2, True)

"""The environment that is the robot."""

import signal

import numpy as np
import pytest
from gymnasium.spaces import Box

from adr_service.client.robot.environment import (
    check_environment,
    closing_in_time,
    interrupted_later,
    load_environment,
)
from adr_service.client.robot.limits import Limits
from adr_service.errors import InvalidInput

ARM = {"name": "arm", "observation_columns": ["a"] * 4, "actions": 2}
ARM |= {"action_low": [-1.0, 0.2], "action_high": [1.0, 1.0]}


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("tests.robots", "--env needs module:factory; given 'tests.robots'"),
        (":fast_arm", "--env needs module:factory"),
        ("tests.robots:missing", "tests.robots:missing cannot be imported"),
        ("no_such_module:make", "cannot be imported: No module named 'no_such_module'"),
        ("tests.robots:not_an_environment", r"makes a object; needed is a gymnasium\.Env"),
        ("tests.robots:MODULE", "tests.robots:MODULE is a str; needed is a function or a class"),
        ("tests.robots:StuckArm", "called without arguments: missing a required argument: 'hangs_"),
    ],
)
def test_a_path_to_no_environment_is_refused(path, message):
    with pytest.raises(InvalidInput, match=message):
        load_environment(path)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_close_is_not_interrupted(number):
    """An impatient second Ctrl-C would leave an arm half-way to where it parks."""

    class Parking:
        is_parked = False

        def close(self):
            signal.raise_signal(number)
            self.is_parked = True

    before, arm = signal.getsignal(number), Parking()
    with closing_in_time(arm, 60.0, pytest.fail):
        pass
    assert arm.is_parked
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_comes_while_an_episode_is_written_waits_for_its_end(number):
    before, seen = signal.getsignal(number), []
    signal.signal(number, lambda *_: seen.append("ends"))
    try:
        with interrupted_later():
            signal.raise_signal(number)
            seen.append("written")
    finally:
        signal.signal(number, before)
    assert seen == ["written", "ends"]


def test_an_environment_of_the_task_is_accepted():
    env = load_environment("tests.robots:fast_arm")
    check_environment(env, ARM, Limits(actions=(1.0, 2.0)))


@pytest.mark.parametrize(
    ("about", "limits", "message"),
    [
        ({**ARM, "actions": 3}, Limits(), "the environment has observations"),
        (ARM, Limits(actions=(1.0, 1.0, 1.0)), "3 limits given for 2 actions; give one, or each"),
        (ARM, Limits(actions=(-1.0,)), "limits of actions must be positive; given"),
        (ARM, Limits(actions=(float("inf"),)), "limits of actions must be positive"),
        (ARM, Limits(actions=(1.0, 0.1)), "there is no action of arm, which takes"),
    ],
)
def test_an_environment_or_limits_that_do_not_fit_are_refused(about, limits, message):
    env = load_environment("tests.robots:fast_arm")
    with pytest.raises(InvalidInput, match=message):
        check_environment(env, about, limits)


def test_an_environment_that_takes_less_than_the_task_sends_needs_a_limit():
    env = load_environment("tests.robots:fast_arm")
    env.action_space = Box(-0.3, 0.3, (2,))
    check_environment(env, {**ARM, "action_low": [-1.0, -1.0]}, Limits(actions=(0.3,)))
    with pytest.raises(InvalidInput, match=r"would be sent .* limit them by --max-action"):
        check_environment(env, ARM, Limits(actions=(0.4,)))


def test_an_environment_that_takes_all_that_a_plan_asks_for_is_accepted():
    """It need not take what the task could ask for."""
    env = load_environment("tests.robots:fast_arm")
    env.action_space = Box(-0.3, 0.3, (2,))
    arm = {**ARM, "action_low": [-1.0, -1.0]}
    check_environment(env, arm, Limits(), (np.array([-0.3, 0.1]), np.array([0.2, 0.3])))
    with pytest.raises(InvalidInput, match=r"would be sent \[-0\.3, 0\.1\] to \[0\.2, 0\.4\]"):
        check_environment(env, arm, Limits(), (np.array([-0.3, 0.1]), np.array([0.2, 0.4])))

"""One episode on a robot, without a service."""

from contextlib import contextmanager

import numpy as np
import pytest

from adr_service.client.robot.episode import (
    Machine,
    Rollout,
    random_actions,
    run_episode,
    seed_of,
    slowness,
    to_npz,
)
from adr_service.client.robot.limits import Limits
from adr_service.errors import InvalidInput
from adr_service.npz import read_arrays
from adr_service.simulation.batch import control_period
from adr_service.tasks.catalogue import get_task
from adr_service.transitions import TransitionDataset
from tests.robots import SlowArm, blind_arm, fast_arm

ARM = get_task("arm")
ABOUT = {
    "name": "arm",
    "observation_columns": list(ARM.columns),
    "measured_columns": ARM.measured,
    "actions": 2,
    "action_low": [-1.0, -1.0],
    "action_high": [1.0, 1.0],
    "control_period_s": control_period(ARM),
}
TASK = {"kind": "rollout", "number": 1, "seed": 2, "transitions": 20}


class OldArm(SlowArm):
    """Answers as environments of Gym did before Gymnasium, in one of its two calls."""

    def __init__(self, call):
        super().__init__(0.0)
        self.call = call

    def reset(self, **given):
        return super().reset(**given)[0 if self.call == "reset" else slice(None)]

    def step(self, action):
        return super().step(action)[:4] if self.call == "step" else super().step(action)


class Heart:
    """A heart without a service."""

    steps = 0

    @contextmanager
    def watching(self, name, seconds):
        yield


def run(env, limits=None, why_stop=str, act=None):
    machine = Machine("here", env, ABOUT, limits or Limits())
    return run_episode(machine, TASK, act or random_actions(TASK, ABOUT), Heart(), why_stop)


def test_an_episode_has_as_many_transitions_as_its_task_asks_for():
    episode = run(fast_arm())
    assert episode.observations.shape == (21, 4)
    assert episode.actions.shape == (20, 2)
    assert episode.rewards.shape == (20,)
    assert (episode.limited, episode.wrong) == (0, "")


class Reusing(SlowArm):
    """Its driver fills one buffer again and again, and scales commands where they are."""

    def __init__(self):
        super().__init__(0.0)
        self.buffer = np.zeros(4)

    def reset(self, **given):
        observation, info = super().reset(**given)
        self.buffer[:] = observation
        return self.buffer, info

    def step(self, action):
        observation, *rest = super().step(action.copy())
        self.buffer[:] = observation
        action *= 0.5
        return self.buffer, *rest


def test_a_driver_that_reuses_its_arrays_changes_no_record():
    same, usual = run(Reusing()), run(fast_arm())
    np.testing.assert_array_equal(same.observations, usual.observations)
    np.testing.assert_array_equal(same.actions, usual.actions)


def test_an_episode_repeats_with_its_task():
    first, second = run(fast_arm()), run(fast_arm())
    np.testing.assert_array_equal(first.actions, second.actions)
    other = {**TASK, "number": 2}
    assert seed_of(TASK) == seed_of(dict(TASK)) != seed_of(other)


def test_a_trajectory_keeps_actions_as_they_were_sent_and_the_rewards():
    episode = run(fast_arm(), Limits(actions=(0.25,)))
    assert np.abs(episode.actions).max() == 0.25
    assert episode.limited > 0
    content = to_npz(episode, ABOUT, "here")
    arrays = read_arrays(content, ["rewards", *TransitionDataset.ARRAYS])
    np.testing.assert_array_equal(arrays["actions"], episode.actions)
    np.testing.assert_array_equal(arrays["rewards"], episode.rewards)
    assert str(arrays["origin"]) == "here"


def test_a_sensor_that_fails_ends_the_episode_before_that_transition():
    episode = run(blind_arm())
    assert len(episode.actions) == len(episode.rewards) == 10
    assert episode.wrong.startswith("the robot showed [nan, nan")


class Reshaped(SlowArm):
    """Shows its numbers in another form after ten steps."""

    def __init__(self, form):
        super().__init__(0.0)
        self.form = form

    def step(self, action):
        observation, *rest = super().step(action)
        return self.form(observation) if len(self.actions) > 10 else observation, *rest


@pytest.mark.parametrize(
    ("form", "shape"),
    [
        (lambda observation: observation[:3], "(3,)"),
        (lambda observation: np.append(observation, 0.0), "(5,)"),
        (lambda observation: observation[None], "(1, 4)"),
        (lambda observation: None, "()"),
    ],
)
def test_an_observation_of_another_shape_ends_the_episode_before_that_transition(form, shape):
    episode = run(Reshaped(form))
    assert len(episode.actions) == len(episode.rewards) == 10
    assert episode.wrong == (
        f"the robot showed an observation of shape {shape}; arm has (4,): {', '.join(ARM.columns)}"
    )


def test_a_policy_whose_action_is_not_finite_is_not_obeyed():
    env = fast_arm()
    episode = run(env, act=lambda observations: np.full((1, 2), np.nan))
    assert env.actions == []
    assert episode.wrong.startswith("the policy's action is [nan, nan]")


@pytest.mark.parametrize(("action", "steps"), [(1.001, 0), (1.0000001, TASK["transitions"])])
def test_an_action_beyond_the_tasks_bounds_is_not_sent(action, steps):
    """As that of a policy of before the owner narrowed them."""
    env = fast_arm()
    episode = run(env, act=lambda observations: np.full((1, 2), [0.0, -action]))
    assert len(env.actions) == steps
    assert ("beyond the task's bounds" in episode.wrong) == (steps == 0)


def test_the_owners_time_cuts_an_episode():
    episode = run(fast_arm(), Limits(seconds=5 * ABOUT["control_period_s"] + 1e-9))
    assert len(episode.actions) <= 5
    assert "here may move for" in episode.wrong


@pytest.mark.parametrize("moves", [0, 3])
def test_an_episode_that_should_stop_does_not_move_on(moves):
    env = fast_arm()
    episode = run(env, why_stop=lambda: "stop" if len(env.actions) >= moves else "")
    assert len(episode.actions) == len(env.actions) == moves


@pytest.mark.parametrize(
    ("period_s", "remark"),
    [
        (
            0.05,
            "a step took 0.05 s on average, and counts as 0.02 s: methods will take the robot for",
        ),
        (0.0221, "a step took 0.0221 s"),
        (0.0219, ""),
        (np.nan, ""),
    ],
)
def test_commands_that_come_too_slowly_are_remarked(period_s, remark):
    found = slowness(period_s, ABOUT)
    assert found.startswith(remark)
    assert bool(found) == bool(remark)


class Aborting(SlowArm):
    """Its sensors fail, and it stops."""

    def step(self, action):
        observation, reward, terminated, _, info = super().step(action)
        return observation * np.nan, reward, terminated, True, info


def test_a_sensor_that_fails_is_the_reason_also_where_the_environment_stops():
    episode = run(Aborting(0.0))
    assert episode.wrong.startswith("the robot showed [nan")
    assert not episode.is_cut


class Counting(SlowArm):
    """Counts its resets."""

    resets = 0

    def reset(self, **given):
        self.resets += 1
        return super().reset(**given)


def test_an_episode_that_should_stop_at_once_is_not_even_reset():
    stopped, played = Counting(0.0), Counting(0.0)
    run(stopped, why_stop=lambda: "stop")
    run(played)
    assert (stopped.resets, played.resets) == (0, 1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ("reset", r"returned a ndarray; Gymnasium's return a tuple of 2: observation, info"),
        ("step", r"returned a tuple of 4; Gymnasium's return a tuple of 5: observation, reward, "),
    ],
)
def test_an_environment_of_older_gym_is_refused(call, message):
    with pytest.raises(InvalidInput, match=message):
        run(OldArm(call))


class Unscored(SlowArm):
    """A driver that knows no reward."""

    def step(self, action):
        observation, _, *rest = super().step(action)
        return observation, None, *rest


def test_a_reward_that_is_no_number_is_refused():
    with pytest.raises(InvalidInput, match="step returned the reward None; needed is a number"):
        run(Unscored(0.0))


class Unordered(SlowArm):
    def reset(self, **given):
        return {"position": 0.0}, {}


def test_an_observation_that_is_no_array_is_refused():
    with pytest.raises(InvalidInput, match=r"the observation .* needed is an array"):
        run(Unordered(0.0))


def test_where_rewards_are_not_recorded_they_may_be_anything():
    rollout = Rollout(
        Machine("here", Unscored(0.0), ABOUT, Limits()), Heart(), 3, has_rewards=False
    )
    rollout.reset(0)
    while not rollout.is_over:
        rollout.step(random_actions(TASK, ABOUT))
    assert (len(rollout.episode().actions), rollout.episode().wrong) == (3, "")

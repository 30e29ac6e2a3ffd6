"""Planned commands on a simulated machine."""

import threading

import gymnasium
import numpy as np
import pytest

import adr_service  # noqa: F401, as it registers the environments
from adr_service.client.robot.environment import RobotFailed
from adr_service.client.robot.limits import Limits
from adr_service.client.robot.playback import Player, _check_start, check_commands
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.plans import read_plan
from adr_service.criticism.plausibility import check_usable
from adr_service.criticism.simulator import Simulator
from adr_service.errors import InvalidInput
from adr_service.npz import read_arrays, write_arrays
from adr_service.simulation.batch import control_period
from adr_service.tasks.catalogue import get_task, source_of
from tests.robots import NarrowArm, SlowArm

TASK = get_task("arm")
PERIOD = control_period(TASK)


def plan(episodes=10, rows=30, scale=1.0, period=PERIOD):
    rng = np.random.default_rng(0)
    return write_arrays(
        {
            "time": np.tile(period * np.arange(rows), episodes),
            "ctrl": scale * rng.uniform(-1, 1, (episodes * rows, 2)),
            "episode": np.repeat(np.arange(episodes), rows),
        }
    )


def never(why):
    pytest.fail(why)


def play(env, task, limits, commands, hangs, start=None):
    player = Player(env, task, limits, keep=lambda played: None)
    player.play(commands, hangs, start)
    return player.played


@pytest.fixture
def robot():
    with gymnasium.make("adr/RandomArm-v0") as env:
        yield env


def test_commands_become_a_measurement_with_a_row_for_each(robot):
    commands = read_plan(plan(), 2, PERIOD)[0]
    played = play(robot, TASK, Limits(), commands, never)
    data = played.measurement
    assert [last - first for first, last in data.spans()] == [30] * 10
    np.testing.assert_array_equal(data.ctrl[:29], commands[0][:29])
    assert (played.limited, played.shortened) == (0, ())
    check_usable(Measurement.from_npz(data.to_npz()))


def test_the_owners_limit_holds_and_is_counted(robot):
    commands = read_plan(plan(), 2, PERIOD)[0]
    played = play(robot, TASK, Limits(actions=(0.5,)), commands, never)
    assert np.abs(played.measurement.ctrl).max() == 0.5
    sent = np.concatenate([each[:-1] for each in commands])
    assert played.limited == np.sum(np.any(np.abs(sent) > 0.5, axis=1))


def test_an_episode_that_the_environment_ends_is_shorter():
    with gymnasium.make("adr/RandomArm-v0", max_episode_steps=20) as env:
        played = play(env, TASK, Limits(), read_plan(plan(), 2, PERIOD)[0], never)
    assert played.shortened == ("the environment ended the episode early (truncated)",) * 10
    assert [last - first for first, last in played.measurement.spans()] == [21] * 10


def test_each_row_leads_to_the_next_under_its_command(robot):
    """The simulator that the robot is predicts every row from the one before."""
    data = play(robot, TASK, Limits(), read_plan(plan(), 2, PERIOD)[0], never).measurement
    nominal = Nominal.of_task(TASK, source_of("arm", "vanilla"))
    with Simulator(nominal, data, threads=1) as simulator:
        ends = simulator.measured[simulator.starts + 1]
        errors = np.abs(simulator.predict(nominal.start, (), simulator.measured) - ends)
        shifted = np.abs(simulator.predict(nominal.start, (), simulator.measured)[1:] - ends[:-1])
    assert np.median(errors) < 0.1 * np.median(shifted)


def test_the_owners_seconds_hold(robot):
    commands = read_plan(plan(), 2, PERIOD)[0]
    played = play(robot, TASK, Limits(seconds=5.5 * PERIOD), commands, never)
    assert [last - first for first, last in played.measurement.spans()] == [6] * 10
    assert set(played.shortened) == {
        f"the robot may move for {5.5 * PERIOD:g} s (--max-seconds), and these are over"
    }


class Stuck(gymnasium.Wrapper):
    """A robot whose step does not return in the third episode, until it is let go."""

    def __init__(self, env):
        super().__init__(env)
        self.episodes, self.let_go = 0, threading.Event()

    def reset(self, **options):
        self.episodes += 1
        return super().reset(**options)

    def step(self, action):
        if self.episodes == 3:
            assert self.let_go.wait(60)
        return super().step(action)


def test_what_was_played_is_there_when_the_robot_does_not_answer(robot):
    stuck, heard = Stuck(robot), []
    player = Player(stuck, TASK, Limits(seconds=30 * PERIOD), keep=lambda played: None)

    def hangs(why):
        heard.append((why, player.played))
        stuck.let_go.set()

    player.play(read_plan(plan(), 2, PERIOD)[0], hangs)
    [(why, played)] = heard
    assert "the environment's step did not return within" in why
    assert len(played.measurement.spans()) == 2


class Broken(gymnasium.Wrapper):
    """A robot that fails in its third reset."""

    episodes = 0

    def reset(self, **options):
        self.episodes += 1
        if self.episodes == 3:
            raise OSError("the bus is gone")
        return super().reset(**options)


def test_what_was_played_is_there_when_the_robot_fails(robot):
    kept = []
    player = Player(Broken(robot), TASK, Limits(), kept.append)
    with pytest.raises(RobotFailed, match="reset failed, OSError: the bus is gone; see to the"):
        player.play(read_plan(plan(), 2, PERIOD)[0], never)
    assert len(player.played.measurement.spans()) == 2
    # after each episode, because a process that is killed does nothing in the end
    assert [len(played.measurement.spans()) for played in kept] == [1, 2]


class Stopped(Stuck):
    """A robot whose owner presses Ctrl-C in the third episode."""

    def step(self, action):
        if self.episodes == 3:
            raise KeyboardInterrupt
        return super().step(action)


def test_the_owner_can_stop_it_and_keeps_what_was_played(robot):
    player = Player(Stopped(robot), TASK, Limits(), keep=lambda played: None)
    with pytest.raises(KeyboardInterrupt):
        player.play(read_plan(plan(), 2, PERIOD)[0], never)
    assert len(player.played.measurement.spans()) == 2


def test_a_machine_that_is_slower_than_its_period_is_remarked():
    commands = read_plan(plan(episodes=1, rows=4), 2, PERIOD)[0]
    assert "a step took " in play(SlowArm(0.05), TASK, Limits(), commands, never).slow
    single = read_plan(plan(episodes=1, rows=2), 2, PERIOD)[0]
    assert play(SlowArm(0.05), TASK, Limits(), single, never).slow == ""


def test_a_plan_that_no_measurement_can_come_of_is_refused_before_anything_moves():
    class Still(gymnasium.Env):
        def reset(self, **options):
            pytest.fail("it moved")

    with pytest.raises(InvalidInput, match="a pose of 3 positions; arm has 2"):
        play(Still(), TASK, Limits(), read_plan(plan(), 2, PERIOD)[0], never, np.zeros(3))
    humanoid = get_task("humanoid")
    with pytest.raises(InvalidInput, match="free"):
        play(Still(), humanoid, Limits(), [np.zeros((3, 17))], never)


def test_commands_beyond_the_tasks_bounds_are_refused():
    with pytest.raises(InvalidInput, match=r"command . is .* in row .*; arm takes -1 to 1"):
        check_commands(TASK, read_plan(plan(scale=50.0), 2, PERIOD)[0])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (write_arrays({"ctrl": np.zeros((3, 2))}), "the plan lacks .*adr criticise --next"),
        (plan(period=0.5), "hold for 0.5 s; the robot's hold for"),
        (plan(scale=np.nan), "ctrl is not finite"),
        (plan(rows=1), "has a single row"),
        (
            write_arrays({"time": np.arange(3.0), "ctrl": np.zeros((3, 3)), "episode": [0, 0, 0]}),
            "2",
        ),
    ],
)
def test_a_plan_of_another_robot_is_refused(content, message):
    with pytest.raises(InvalidInput, match=message):
        read_plan(content, 2, PERIOD)[0]


def test_nothing_is_sent_from_another_pose_than_the_plans(robot):
    commands = read_plan(plan(), 2, PERIOD)[0]
    firsts = play(robot, TASK, Limits(), commands, never).measurement
    pose = np.median([firsts.qpos[first] for first, _ in firsts.spans()], axis=0)
    assert len(play(robot, TASK, Limits(), commands, never, pose).measurement.spans()) > 1
    with pytest.raises(InvalidInput, match=r"the plan begins at .* and the robot is at"):
        play(robot, TASK, Limits(), commands, never, pose + np.array([1.0, 0.0]))
    turned = pose + np.array([2 * np.pi, -2 * np.pi])  # the same pose of joints without limits
    assert len(play(robot, TASK, Limits(), commands, never, turned).measurement.spans()) > 1


@pytest.mark.parametrize(
    ("moved", "is_there"),
    [((0.04, 0), True), ((0.06, 0), False), ((0, 0.19), True), ((0, 0.21), False)],
)
def test_a_slide_is_nearer_to_the_plans_pose_than_a_hinge(moved, is_there):
    """[m] of Hopper's height, and [rad] of its knee, which has limits."""
    hopper = get_task("hopper")
    shown = hopper.initial(1, np.random.default_rng(0)).qpos[0]
    observation = np.zeros(len(hopper.columns))
    observation[: len(shown) - 1] = shown[1:]
    start = hopper.state(observation[None]).qpos[0]
    start[[1, 3]] += moved
    if is_there:
        _check_start(hopper, observation, start)
    else:
        with pytest.raises(InvalidInput, match=r"to within 0\.2 rad or 0\.05 m, or plan"):
            _check_start(hopper, observation, start)


@pytest.mark.parametrize("pose", [[0.0, np.nan], [[0.0, 0.0]], ["a", "b"]])
def test_a_pose_that_is_none_is_refused(pose):
    arrays = read_arrays(plan(), ["time", "ctrl", "episode"])
    with pytest.raises(InvalidInput, match="qpos0"):
        read_plan(write_arrays({**arrays, "qpos0": np.array(pose)}), 2, PERIOD)


class Elsewhere(SlowArm):
    """Its joints stand elsewhere after every reset but the first."""

    is_new = True

    def reset(self, **given):
        observation, info = super().reset(**given)
        moved = observation + (0.0 if self.is_new else 1.0)
        self.is_new = False
        return moved, info


def test_a_later_episode_that_begins_in_another_pose_is_not_played():
    env, (shown, _) = Elsewhere(0.0), SlowArm(0.0).reset(seed=0)
    commands = read_plan(plan(episodes=3), 2, PERIOD)[0]
    played = play(env, TASK, Limits(), commands, never, shown[:2])
    assert len(env.actions) == 29
    assert played.shortened == ("it did not begin in the plan's pose",) * 2


class Narrowing(SlowArm):
    """Shows a number fewer after 40 steps, which are within its second episode."""

    def step(self, action):
        observation, *rest = super().step(action)
        return observation[:-1] if len(self.actions) > 40 else observation, *rest


def test_an_episode_whose_observations_change_their_shape_is_the_last():
    commands, env = read_plan(plan(episodes=3), 2, PERIOD)[0], Narrowing(0.0)
    player = Player(env, TASK, Limits(), keep=lambda played: None)
    why = r"the robot showed an observation of shape \(3,\); arm has \(4,\)"
    with pytest.raises(RobotFailed, match=f"episode 2 of 3: {why}.*; see to the robot"):
        player.play(commands, never)
    assert len(env.actions) == 41
    assert [last - first for first, last in player.played.measurement.spans()] == [30, 12]


@pytest.mark.parametrize("start", [None, np.zeros(2)])
def test_a_robot_that_shows_too_few_numbers_is_sent_nothing(start):
    env, commands = NarrowArm(0.0), read_plan(plan(episodes=2), 2, PERIOD)[0]
    with pytest.raises(RobotFailed, match=r"episode 1 of 2: the robot showed .* shape \(3,\)"):
        play(env, TASK, Limits(), commands, never, start)
    assert env.actions == []

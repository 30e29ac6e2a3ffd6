"""Planned commands on a simulated machine."""

import gymnasium
import numpy as np
import pytest

import adr_service  # noqa: F401, as it registers the environments
from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput
from adr_service.npz import write_arrays
from adr_service.simulation.batch import control_period
from adr_service.tasks.catalogue import get_task
from api.robot.limits import Limits
from api.robot.playback import play, read_plan

TASK = get_task("arm")


def plan(episodes=10, rows=30, scale=1.0, period=None):
    rng = np.random.default_rng(0)
    period = control_period(TASK) if period is None else period
    return write_arrays(
        {
            "time": np.tile(period * np.arange(rows), episodes),
            "ctrl": scale * rng.uniform(-1, 1, (episodes * rows, 2)),
            "episode": np.repeat(np.arange(episodes), rows),
        }
    )


@pytest.fixture
def robot():
    with gymnasium.make("adr/RandomArm-v0") as env:
        yield env


def test_commands_become_a_measurement_with_a_row_for_each(robot):
    commands = read_plan(plan(), TASK)
    played = play(robot, TASK, Limits(), commands)
    data = played.measurement
    assert [last - first for first, last in data.spans()] == [30] * 10
    np.testing.assert_array_equal(data.ctrl[:29], commands[0][:29])
    assert (played.limited, played.shortened) == (0, 0)
    again = Measurement.from_npz(data.to_npz())
    again.check_usable()


def test_the_owners_limit_holds_and_is_counted(robot):
    commands = read_plan(plan(), TASK)
    played = play(robot, TASK, Limits(actions=(0.5,)), commands)
    assert np.abs(played.measurement.ctrl).max() == 0.5
    sent = np.concatenate([each[:-1] for each in commands])
    assert played.limited == np.sum(np.any(np.abs(sent) > 0.5, axis=1))


def test_an_episode_that_the_environment_ends_is_shorter():
    with gymnasium.make("adr/RandomArm-v0", max_episode_steps=20) as env:
        played = play(env, TASK, Limits(), read_plan(plan(), TASK))
    assert played.shortened == 10
    assert [last - first for first, last in played.measurement.spans()] == [21] * 10


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (write_arrays({"ctrl": np.zeros((3, 2))}), "the plan lacks .*adr criticise --next"),
        (plan(period=0.5), "hold for 0.5 s; those of arm for"),
        (plan(scale=np.nan), "finite numbers"),
    ],
)
def test_a_plan_of_another_robot_is_refused(content, message):
    with pytest.raises(InvalidInput, match=message):
        read_plan(content, TASK)

"""Recordings that criticisms read, and measurements that methods read."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.recordings import (
    as_measurement,
    as_recording,
    is_measured,
    read_measurement,
    read_recording,
)
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import random_actions
from adr_service.tasks.base import State
from adr_service.tasks.catalogue import get_task, hidden_of
from adr_service.transitions import TransitionDataset
from tests.planted import ARM, recorded, waving_policy

CLEAN = recorded(waving_policy(), episodes=3, steps=20)
MEASUREMENT = as_measurement(ARM, CLEAN)
HOPPER = get_task("hopper")


def hop(steps=15):
    """Whole states (steps + 1, 6 + 6) of a Hopper under random actions, and its recording."""
    hidden, rng = hidden_of("hopper", "vanilla"), np.random.default_rng(0)
    simulation = Simulations(HOPPER, hidden.source, 1)
    simulation.set_dynamics(hidden.values[None])
    simulation.set_state(HOPPER.initial(1, rng))
    act, states, actions = random_actions(HOPPER, rng), [simulation.state], []
    for _ in range(steps):
        actions.append(act(HOPPER.observe(states[-1])))
        simulation.step(actions[-1])
        states.append(simulation.state)
    seen = np.concatenate([HOPPER.observe(state) for state in states])
    columns = HOPPER.columns
    data = TransitionDataset(
        seen[:-1], np.concatenate(actions), seen[1:], np.zeros(steps), 0.008, columns, "random"
    )
    return np.concatenate([np.hstack(state[:2]) for state in states]), data


@pytest.fixture(scope="module")
def hopped():
    return hop()


def test_a_recording_has_a_row_for_each_state():
    np.testing.assert_array_equal(np.bincount(MEASUREMENT.episode), [21, 21, 21])
    np.testing.assert_allclose(MEASUREMENT.time[:3], [0, 0.02, 0.04])
    assert MEASUREMENT.qpos_std is None
    assert MEASUREMENT.qvel_std is None


def test_a_recording_comes_back_as_it_was():
    again = as_recording(ARM, MEASUREMENT)
    for name in ("observations", "actions", "next_observations", "episodes"):
        np.testing.assert_allclose(getattr(again, name), getattr(CLEAN, name), atol=1e-12)
    assert again.columns == CLEAN.columns


def test_what_no_sensor_shows_is_integrated_and_marked(hopped):
    states, data = hopped
    measurement = as_measurement(HOPPER, data)
    assert measurement.qpos_std is not None
    np.testing.assert_array_equal(np.isinf(measurement.qpos_std), [True, *[False] * 5])
    np.testing.assert_allclose(measurement.qpos[:, 1:], states[:, 1:6], atol=1e-9)
    moved = states[:, 0] - states[0, 0]
    np.testing.assert_allclose(measurement.qpos[:, 0], moved, atol=0.02 * np.abs(moved).max())


def test_a_robot_that_no_sensor_shows_whole_still_has_a_recording(hopped):
    _, data = hopped
    again = as_recording(HOPPER, as_measurement(HOPPER, data))
    np.testing.assert_allclose(again.observations, data.observations, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": 2 * MEASUREMENT.time}, "rows of the measurement are 0.04 s apart"),
        (
            {"ctrl_within": np.repeat(MEASUREMENT.ctrl[:, None], 2, axis=1)},
            "commands of the measurement change between its rows",
        ),
        (
            {"qvel_std": np.array([np.inf, np.nan])},
            r"lacks what sensors of arm show: the velocity of \w+",
        ),
        ({"ctrl": 100 + MEASUREMENT.ctrl}, "actions lie outside the bounds of arm"),
        (
            {"qvel": MEASUREMENT.qvel[:, :1]},
            "qvel has 1 column; the model needs 2 columns, for shoulder, elbow",
        ),
    ],
)
def test_a_measurement_that_methods_cannot_use_is_refused(changes, message):
    with pytest.raises(InvalidInput, match=message):
        as_recording(ARM, replace(MEASUREMENT, **changes))


def test_noise_of_next_observations_alone_is_no_measurement():
    noisy = replace(CLEAN, next_observations=CLEAN.next_observations + 0.01)
    with pytest.raises(InvalidInput, match="needs each next observation to be the observation"):
        as_measurement(ARM, noisy)


def test_a_recording_of_another_robot_is_refused(hopped):
    with pytest.raises(InvalidInput, match="11 observations and 3 actions; arm measures 4"):
        as_measurement(ARM, hopped[1])


def test_a_robot_with_a_free_joint_is_refused_with_the_reason():
    humanoid = get_task("humanoid")
    width, commands = humanoid.measured, len(humanoid.action_low)
    rest = np.zeros((3, width))
    data = TransitionDataset(
        rest, np.zeros((3, commands)), rest, np.zeros(3), 0.015, humanoid.columns[:width], "none"
    )
    with pytest.raises(InvalidInput, match="free and ball joints are not supported"):
        as_measurement(humanoid, data)


def test_velocities_that_no_sensor_shows_are_the_rates_of_positions():
    class Encoders(type(ARM)):
        def state(self, observations):
            return State(observations[:, :2], np.zeros((len(observations), 2)))

    data = replace(
        CLEAN,
        observations=CLEAN.observations[:, :2],
        next_observations=CLEAN.next_observations[:, :2],
        columns=ARM.columns[:2],
    )
    measurement = as_measurement(Encoders(columns=ARM.columns[:2], measured=2), data)
    assert measurement.qvel_std is not None
    assert np.all(np.isinf(measurement.qvel_std))
    moved = measurement.qpos[2:21] - measurement.qpos[:19]
    np.testing.assert_allclose(measurement.qvel[1:20], moved / 0.04)


def test_an_angle_is_measured_that_sensors_show_in_parts():
    """A sine and a cosine of the first, and the second beside the first."""

    class Parts(type(ARM)):
        def state(self, observations):
            sine, cosine, both = observations.T
            first = np.arctan2(sine, cosine)
            return State(np.column_stack([first, both - first]), np.zeros((len(both), 2)))

    parts = Parts(columns=("sine", "cosine", "sum"), measured=3)
    np.testing.assert_array_equal(is_measured(parts), [True, True, False, False])


@pytest.mark.parametrize(
    ("task", "hidden"), [("arm", []), ("hopper", [0]), ("half_cheetah", [0]), ("humanoid", [0, 1])]
)
def test_every_state_is_measured_but_where_a_robot_is(task, hidden):
    np.testing.assert_array_equal(np.flatnonzero(~is_measured(get_task(task))), hidden)


def test_either_kind_of_file_is_read():
    measured, learned = MEASUREMENT.to_npz(), CLEAN.to_npz()
    assert read_recording(ARM, learned).to_npz() == learned
    assert read_measurement(ARM, measured).to_npz() == measured
    assert read_measurement(ARM, learned).to_npz() == measured
    assert len(read_recording(ARM, measured)) == len(CLEAN)

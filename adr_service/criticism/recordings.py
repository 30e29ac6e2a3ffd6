"""Recordings of transitions as measurements of states, and back.

    measurement = read_measurement(task, content)   # for a criticism
    data = read_recording(task, content)            # for a method

A recording has what a task's sensors show at each control step; a measurement has whole states.
Each of the two is read as the other where that loses nothing.
"""

from dataclasses import replace

import mujoco
import numpy as np

from adr_service.arrays import Mask, Matrix, Vector
from adr_service.criticism.compatibility import check_columns, check_state, joints_of
from adr_service.criticism.measurements import Measurement, is_measurement
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace
from adr_service.simulation.batch import Simulations, control_period
from adr_service.simulation.model import compiled
from adr_service.simulation.replay import check_recorded
from adr_service.tasks.base import Source, State, Task
from adr_service.transitions import TransitionDataset

_SAME_PERIOD = 1e-3  # relative
_AS_FILED = Source(ParameterSpace(()))  # the task's simulator as its file has it


def read_measurement(task: Task, content: bytes) -> Measurement:
    """The measurement in an `.npz`, or its recording as one; raises InvalidInput."""
    if is_measurement(content):
        return Measurement.from_npz(content)
    return as_measurement(task, TransitionDataset.from_npz(content))


def read_recording(task: Task, content: bytes) -> TransitionDataset:
    """The recording of this task in an `.npz`, or its measurement as one; raises InvalidInput."""
    if is_measurement(content):
        return as_recording(task, Measurement.from_npz(content))
    data = TransitionDataset.from_npz(content)
    check_recorded(task, data)
    return data


def as_measurement(task: Task, data: TransitionDataset) -> Measurement:
    """A recording as a measurement that a criticism can read.

    What no sensor shows is marked as not measured. Such positions are the integrals of their
    velocities, and such velocities the rates of their positions. Raises InvalidInput for the data
    of another robot, a model with other joints than slides and hinges, and next observations that
    have noise of their own.
    """
    check_state(compiled(task.xml))
    check_recorded(task, data)
    measurement = measurement_of(task, data)
    position, velocity = np.split(is_measured(task), 2)
    return replace(
        measurement.inferring(~position, ~velocity, data.dt),
        qpos_std=_deviations(position),
        qvel_std=_deviations(velocity),
    )


def as_recording(task: Task, measurement: Measurement) -> TransitionDataset:
    """A measurement as a recording from which methods can learn.

    The noise that the measurement gives of its sensors is left out: a recording has no place for
    it. Raises InvalidInput for the data of another robot, rows that are not one control step apart
    (to a thousandth), commands that change between rows, and a lack of what the task's sensors
    show.
    """
    model = compiled(task.xml)
    check_columns(model, measurement)
    period, given = control_period(task), measurement.period()
    if not np.isclose(given, period, rtol=_SAME_PERIOD):
        raise InvalidInput(
            f"rows of the measurement are {given:g} s apart; methods learn from control steps, "
            f"which are {period:g} s on {task.name}"
        )
    if measurement.ctrl_within is not None:
        raise InvalidInput(
            "commands of the measurement change between its rows (ctrl_within); methods learn "
            "from control steps, in which they are constant"
        )
    if (lacking := is_measured(task) & ~measurement.is_measured()).any():
        raise InvalidInput(
            f"the measurement lacks what sensors of {task.name} show: {_named(model, lacking)}"
        )
    shown = observed(task, _AS_FILED, np.hstack([measurement.qpos, measurement.qvel]))
    rows = np.flatnonzero(np.diff(measurement.episode) == 0)
    data = TransitionDataset(
        observations=shown[rows],
        actions=measurement.ctrl[rows],
        next_observations=shown[rows + 1],
        episodes=measurement.episode[rows],
        dt=period,
        columns=task.columns[: task.measured],
        origin="a measurement of states and commands",
    )
    check_recorded(task, data)
    return data


def measurement_of(task: Task, data: TransitionDataset) -> Measurement:
    """A recording as rows: one for each state, the last of an episode with the command before.

    What no sensor shows is as `task.state` has it.
    """
    data.check_chained("a measurement of states")
    parts = data.split()
    states = task.state(np.concatenate([_readings(part) for part in parts]))
    lengths = [len(part) + 1 for part in parts]
    return Measurement(
        time=np.concatenate([data.dt * np.arange(length, dtype=np.float64) for length in lengths]),
        qpos=states.qpos,
        qvel=states.qvel,
        ctrl=np.concatenate([part.actions[[*range(len(part)), -1]] for part in parts]),
        episode=np.repeat(np.arange(len(parts)), lengths),
    )


def is_measured(task: Task) -> Mask:
    """(nq + nv,) true for the positions and velocities that depend on what sensors show.

    Each sensor is moved by itself, from two uneven readings: an angle may be in a sine and a
    cosine, or in a difference.
    """
    count = task.measured
    ways = [np.linspace(low, 0.5, count) + 0.1 * np.eye(count + 1, count) for low in (0.1, -0.4)]
    depends: list[Mask] = []
    for readings in ways:  # the last row is where none has moved
        states = np.concatenate(task.state(readings)[:2], axis=1)
        depends.append(np.any(states[:-1] != states[-1], axis=0))
    return np.any(depends, axis=0)


def observed(task: Task, source: Source, states: Matrix) -> Matrix:
    """The measured columns (N, s) of states (N, nq + nv)."""
    simulation = Simulations(task, source, 1)
    rows: list[Vector] = []
    for qpos, qvel in zip(*np.split(states, 2, axis=1), strict=True):
        simulation.set_state(State(qpos, qvel))
        rows.append(task.observe(simulation.state)[0, : task.measured])
    return np.array(rows)


def _named(model: mujoco.MjModel, chosen: Mask) -> str:
    """The chosen ones (nq + nv,) of a model's positions and velocities, by their joints."""
    kinds = [f"the {k} of {name}" for k in ("position", "velocity") for name in joints_of(model)]
    return ", ".join(kinds[number] for number in np.flatnonzero(chosen))


def _readings(episode: TransitionDataset) -> Matrix:
    return np.concatenate([episode.observations, episode.next_observations[-1:]])


def _deviations(is_shown: Mask) -> Vector | None:
    """The sensors' noise: NaN, to be estimated, and infinite where there is no sensor."""
    return None if is_shown.all() else np.where(is_shown, np.nan, np.inf)

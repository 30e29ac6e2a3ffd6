"""Planned commands on a robot, open loop, as a measurement; no service is needed."""

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from adr_service.arrays import Array3, Vector
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.smoothing import is_measured, measurement_of
from adr_service.errors import InvalidInput
from adr_service.npz import read_arrays
from adr_service.simulation.batch import control_period
from adr_service.tasks.base import Task
from adr_service.transitions import TransitionDataset
from api.robot.environment import Env
from api.robot.limits import Limits

_PLANNED = ("time", "ctrl", "episode")


@dataclass(frozen=True)
class Playback:
    """What came of planned commands."""

    measurement: Measurement
    limited: int  # commands that the owner's limit changed; the measurement has what was sent
    shortened: int  # episodes that ended before all their commands


def read_plan(content: bytes, task: Task) -> list[Vector]:
    """The commands (rows, nu) of each episode. Raises InvalidInput for another robot's."""
    arrays = read_arrays(content, _PLANNED)
    if missing := [name for name in _PLANNED if name not in arrays]:
        raise InvalidInput(f"the plan lacks {missing}; `adr criticise --next` writes one")
    time_of, ctrl, episode = (arrays[name] for name in _PLANNED)
    width, period = len(task.action_low), control_period(task)
    if ctrl.ndim != 2 or ctrl.shape[1] != width or not np.all(np.isfinite(ctrl)):
        raise InvalidInput(
            f"the plan's commands have shape {ctrl.shape}; {task.name} takes (rows, {width}) "
            "finite numbers"
        )
    steps = np.diff(time_of)[np.diff(episode) == 0]
    if not np.allclose(steps, period, rtol=1e-3):
        raise InvalidInput(
            f"the plan's commands hold for {np.median(steps):g} s; those of {task.name} for "
            f"{period:g} s"
        )
    return np.split(ctrl, np.flatnonzero(np.diff(episode)) + 1)


def about(task: Task) -> dict[str, Any]:
    """What `check_environment` compares an environment with."""
    names = {"name": task.name, "observation_columns": task.columns}
    return {**names, "actions": len(task.action_low)}


def play(env: Env, task: Task, limits: Limits, plan: list[Vector]) -> Playback:
    """Reset the robot and send the commands, for each episode.

    An episode ends early where the environment ends it, or after the owner's `limits.seconds`.
    """
    parts: list[TransitionDataset] = []
    limited = shortened = 0
    for number, commands in enumerate(plan):
        part, changed = _episode(env, task, limits, commands, number)
        limited += changed
        shortened += len(part) < len(commands) - 1
        parts.append(part)
    whole = measurement_of(task, TransitionDataset.concatenate(parts))
    position, velocity = np.split(np.where(is_measured(task), np.nan, np.inf), 2)
    whole = replace(
        whole,
        qpos_std=None if np.isnan(position).all() else position,
        qvel_std=None if np.isnan(velocity).all() else velocity,
    )
    return Playback(whole, limited, shortened)


def _episode(
    env: Env, task: Task, limits: Limits, commands: Array3, number: int
) -> tuple[TransitionDataset, int]:
    """One episode, and how many of its commands were limited. The last command is not sent: the
    last row of a measurement has none."""
    observation, _ = env.reset(seed=number)
    seen, sent, limited, began = (
        [np.asarray(observation, dtype=np.float64)],
        [],
        0,
        time.monotonic(),
    )
    for command in commands[:-1]:
        if not limits.allows(time.monotonic() - began):
            break
        action = limits.apply(command)
        limited += not np.array_equal(action, command)
        observation, _, terminated, truncated, _ = env.step(action)
        seen.append(np.asarray(observation, dtype=np.float64))
        sent.append(action)
        if not np.all(np.isfinite(seen[-1])):
            raise InvalidInput(f"the robot showed {seen[-1].tolist()} in episode {number}")
        if terminated or truncated:
            break
    if not sent:
        raise InvalidInput(f"episode {number} ended before its first command")
    rows = np.array(seen)[:, : task.measured]
    data = TransitionDataset(
        observations=rows[:-1],
        actions=np.array(sent),
        next_observations=rows[1:],
        episodes=np.zeros(len(sent), dtype=np.int64),
        dt=control_period(task),
        columns=tuple(task.columns[: task.measured]),
        origin="played commands",
    )
    return data, limited

"""Planned commands on a robot, open loop, as a measurement; no service is needed."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.client.robot.environment import Env
from adr_service.client.robot.limits import Limits
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.recordings import as_measurement, is_measured
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import control_period
from adr_service.tasks.base import Task
from adr_service.transitions import TransitionDataset

_AWAY = 0.2  # [rad or m] from the pose to start from


@dataclass(frozen=True)
class Playback:
    """Recorded episodes of a plan."""

    measurement: Measurement
    limited: int  # commands that the owner's limit changed; the measurement has what was sent
    shortened: tuple[str, ...]  # why episodes ended before all their commands


@dataclass(frozen=True)
class _Episode:
    data: TransitionDataset
    limited: int
    why_short: str  # empty: it is complete


def about(task: Task) -> dict[str, Any]:
    """The facts that `check_environment` compares an environment with."""
    names = {"name": task.name, "observation_columns": task.columns}
    return {**names, "actions": len(task.action_low)}


def check_commands(task: Task, plan: Sequence[Matrix]) -> None:
    """Raises InvalidInput for commands beyond the task's bounds."""
    whole = np.concatenate(plan)
    beyond = (whole < task.action_low) | (whole > task.action_high)
    if beyond.any():
        row, column = np.argwhere(beyond)[0]
        raise InvalidInput(
            f"the plan's command {column} is {whole[row, column]:g} in row {row}; {task.name} "
            f"takes {task.action_low[column]:g} to {task.action_high[column]:g}"
        )


def play(
    env: Env, task: Task, limits: Limits, plan: Sequence[Matrix], start: Vector | None = None
) -> Playback:
    """Reset the robot and send the commands (rows, nu), for each episode.

    `start` (nq,) is the pose from which the plan begins: nothing is sent from another one. An
    episode ends early where the environment ends it, after the owner's `limits.seconds`, or at an
    observation that is not finite. Raises InvalidInput for commands beyond the task's bounds before
    anything moves, if the first episode begins in another pose, and if none has a transition.
    """
    check_commands(task, plan)
    episodes = list(_episodes(env, task, limits, plan, start))
    if not episodes:
        raise InvalidInput("no episode of the plan has a single transition")
    whole = as_measurement(task, TransitionDataset.concatenate([each.data for each in episodes]))
    shortened = tuple(each.why_short for each in episodes if each.why_short)
    missing = len(plan) - len(episodes)
    return Playback(
        whole,
        sum(each.limited for each in episodes),
        (*shortened, *["it ended before its first command"] * missing),
    )


def _check_start(task: Task, shown: Vector, start: Vector) -> None:
    """Raises InvalidInput unless a robot that shows this is in the pose to start from."""
    known = is_measured(task)[: len(start)]
    pose = task.state(shown[None, : task.measured]).qpos[0]
    if np.any(np.abs(pose - start)[known] > _AWAY):
        raise InvalidInput(
            f"the plan begins at {np.round(start, 3).tolist()}, and the robot is at "
            f"{np.round(pose, 3).tolist()}, from where the plan would move it elsewhere. Put it "
            "there, or plan from where it is (adr criticise --next, --start)"
        )


def _episodes(
    env: Env, task: Task, limits: Limits, plan: Sequence[Matrix], start: Vector | None
) -> Iterator[_Episode]:
    """The episodes with a transition, until the owner interrupts."""
    try:
        for number, commands in enumerate(plan):
            episode = _episode(env, task, limits, commands, number, start)
            if episode is not None:
                yield episode
    except KeyboardInterrupt:
        return  # what there is, is kept


def _episode(
    env: Env,
    task: Task,
    limits: Limits,
    commands: Matrix,
    number: int,
    start: Vector | None,
) -> _Episode | None:
    """One episode. Its last command is not sent: a measurement's last row has a state alone."""
    observation, _ = env.reset(seed=number)
    seen, sent = [np.asarray(observation, dtype=np.float64)], []
    if start is not None:
        try:
            _check_start(task, seen[0], start)
        except InvalidInput:
            if number == 0:
                raise
            return None  # those before are kept
    limited, why, began = 0, "", time.monotonic()
    for command in commands[:-1]:
        moved = (len(sent) + 1) * control_period(task)
        if not limits.allows(max(moved, time.monotonic() - began)):
            why = f"the robot may move for {limits.seconds:g} s"
            break
        action = limits.apply(command)
        observation, _, terminated, truncated, _ = env.step(action)
        shown = np.asarray(observation, dtype=np.float64)
        if not np.all(np.isfinite(shown)):
            why = f"the robot showed {shown.tolist()}"
            break
        seen.append(shown)
        sent.append(action)
        limited += not np.array_equal(action, command)
        if terminated or truncated:
            why = "the environment ended it" if len(sent) < len(commands) - 1 else ""
            break
    if not sent:
        return None
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
    return _Episode(data, limited, why)

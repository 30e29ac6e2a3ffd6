"""Planned commands on a robot, open loop, as a measurement; no service is needed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.client.robot.environment import Env, RobotFailed
from adr_service.client.robot.episode import Machine, Rollout, recording, slowness
from adr_service.client.robot.heart import Watch
from adr_service.client.robot.limits import Limits
from adr_service.criticism.compatibility import check_state
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.recordings import as_measurement, is_measured
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import control_period
from adr_service.simulation.model import compiled
from adr_service.tasks.base import Task
from adr_service.transitions import TransitionDataset

_AWAY_RAD, _AWAY_M = 0.2, 0.05  # from the pose to start from, at hinges and at slides


@dataclass(frozen=True)
class Playback:
    """Recorded episodes of a plan."""

    measurement: Measurement
    limited: int  # commands that the owner's limit changed; the measurement has what was sent
    shortened: tuple[str, ...]  # why episodes ended before all their commands
    slow: str  # a remark if commands came more slowly than the measurement says


@dataclass(frozen=True)
class _Episode:
    data: TransitionDataset | None  # None: it ended before its first transition
    limited: int
    why_short: str  # empty: it is complete
    is_broken: bool = False
    period_s: float = np.nan  # mean time between two commands


def about(task: Task) -> dict[str, Any]:
    """The facts that `check_environment` compares an environment with, and a recording has."""
    return {
        "name": task.name,
        "observation_columns": task.columns,
        "measured_columns": task.measured,
        "actions": len(task.action_low),
        "action_low": task.action_low.tolist(),
        "action_high": task.action_high.tolist(),
        "control_period_s": control_period(task),
    }


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


class Player:
    """Plays plans on a robot; `keep` gets all that has been recorded after each episode."""

    def __init__(self, env: Env, task: Task, limits: Limits, keep: Callable[[Playback], None]):
        self._machine, self._task = Machine("the robot", env, about(task), limits), task
        self._episodes: list[_Episode] = []
        self._keep = keep

    def play(
        self,
        plan: Sequence[Matrix],
        hangs: Callable[[str], None],
        start: Vector | None = None,
    ) -> None:
        """Reset the robot and send the commands (rows, nu), for each episode.

        `start` (nq,) is the pose from which the plan begins: nothing is sent from another one. An
        episode ends early where the environment ends it, or after the owner's `limits.seconds`. An
        observation that is not finite, or of another shape than the task's, ends the plan with
        RobotFailed, as an OSError of the environment does. Where a call of the environment does not
        return, another thread calls `hangs` with the reason. Raises InvalidInput for commands
        beyond the task's bounds before anything moves, if the first episode begins in another pose,
        and if none has a transition.
        """
        check_commands(self._task, plan)
        model = compiled(self._task.xml)
        check_state(model)  # before anything moves: others give no measurement
        if start is not None and len(start) != model.nq:
            raise InvalidInput(
                f"the plan begins at a pose of {len(start)} positions; {self._task.name} has "
                f"{model.nq}"
            )
        with Watch(hangs).running() as watch:
            for number, commands in enumerate(plan):
                episode = _episode(self._machine, self._task, watch, commands, number, start)
                self._episodes.append(episode)
                if (played := self.played) is not None:
                    self._keep(played)
                if episode.is_broken:  # to go on is to move a robot that is blind
                    where = f"episode {number + 1} of {len(plan)}"
                    raise RobotFailed(f"{where}: {episode.why_short}; see to the robot")
        if self.played is None:
            why = self._episodes[0].why_short
            raise InvalidInput(f"no episode of the plan has a single transition: {why}")

    @property
    def played(self) -> Playback | None:
        """The episodes so far; None if there is no transition."""
        episodes = list(self._episodes)
        parts = [episode.data for episode in episodes if episode.data is not None]
        if not parts:
            return None
        return Playback(
            as_measurement(self._task, TransitionDataset.concatenate(parts)),
            sum(episode.limited for episode in episodes),
            tuple(episode.why_short for episode in episodes if episode.why_short),
            slowness(_mean([e.period_s for e in episodes]), self._machine.about),
        )


def _mean(periods: Sequence[float]) -> float:
    """Mean of those that are known; NaN if none is."""
    known = [period for period in periods if np.isfinite(period)]
    return float(np.mean(known)) if known else np.nan


def _check_start(task: Task, shown: Vector, start: Vector) -> None:
    """Raises InvalidInput unless a robot that shows this is in the pose to start from."""
    known = is_measured(task)[: len(start)]
    pose, model = task.state(shown[None, : task.measured]).qpos[0], compiled(task.xml)
    away, slides = np.abs(pose - start), model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    free = ~slides & ~model.jnt_limited.astype(bool)  # a turn more is the same pose
    away[free] = np.abs((away[free] + np.pi) % (2 * np.pi) - np.pi)
    if np.any((away > np.where(slides, _AWAY_M, _AWAY_RAD))[known]):
        raise InvalidInput(
            f"the plan begins at {np.round(start, 3).tolist()}, and the robot is at "
            f"{np.round(pose, 3).tolist()}, from where the plan would move it elsewhere. Put it "
            f"there, to within {_AWAY_RAD:g} rad or {_AWAY_M:g} m, or plan from where it is (adr "
            "criticise --next, --start)"
        )


def _episode(
    machine: Machine,
    task: Task,
    watch: Watch,
    commands: Matrix,
    number: int,
    start: Vector | None,
) -> _Episode:
    """One episode. Its last command is not sent: a measurement's last row has a state alone."""
    rollout = Rollout(machine, watch, len(commands) - 1, has_rewards=False)
    rollout.reset(number)
    shown = rollout.episode()
    if start is not None and not shown.wrong:
        try:
            _check_start(task, shown.observations[0], start)
        except InvalidInput:
            if number == 0:
                raise
            return _Episode(None, 0, "it did not begin in the plan's pose")
    left = iter(commands)
    while not rollout.is_over:
        rollout.step(lambda seen: next(left)[None])
    episode = rollout.episode()
    if not len(episode.actions):
        return _Episode(None, 0, episode.wrong or "the environment ended it", episode.is_broken)
    is_short = len(episode.actions) < len(commands) - 1
    why_short = episode.wrong or ("the environment ended it" if is_short else "")
    data = recording(episode, machine.about, "played commands")
    return _Episode(data, episode.limited, why_short, episode.is_broken, episode.period_s)

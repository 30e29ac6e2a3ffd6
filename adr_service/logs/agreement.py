"""Does the robot accelerate as its commands make the model accelerate? A check of signs and scales.

Positions of three neighbouring rows give an acceleration, and the model the force that it takes.
That force is regressed on the force of the actuators. The slope is one if the model is right. A
mirrored encoder or motor makes it negative, and a forgotten gain makes it far from one. Friction
lowers it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.compatibility import commanded_actuators
from adr_service.criticism.measurements import Measurement

_MOST = 3000  # rows
_SURE = 3.0  # standard errors
_SMALL, _LARGE = 0.5, 2.0  # slopes that friction or a wrong mass seldom make
_NONE = 0.05  # slope below which a joint hardly obeys
_FEWEST = 3  # episodes
_ROUNDING = 1e-9  # of a command, the most that computing moves it


@dataclass(frozen=True)
class Agreement:
    """The force that a joint's motion takes, per force of its actuators."""

    actuators: tuple[str, ...]  # that move the joint
    joint: str
    slope: float
    error: float  # standard error, over episodes

    def warning(self) -> str:
        """A sentence on what looks wrong and where to look; empty if nothing does."""
        low, high = self.slope - _SURE * self.error, self.slope + _SURE * self.error
        names = " and ".join(self.actuators)
        fields = f"actuators.{self.actuators[0]}.scale and joints.{self.joint}.scale"
        if high < 0:
            return (
                f"{self.joint} accelerates against the commands to {names}; are the signs of "
                f"{fields} right?"
            )
        if high < _SMALL or low > _LARGE:
            more = ", or is friction as large as the drive's force" if high < _SMALL else ""
            moves = (
                f"hardly accelerates by the commands to {names}"
                if self.slope < _NONE
                else f"accelerates {self.slope:.2g} times as much as the commands to {names} let "
                "the model do"
            )
            return f"{self.joint} {moves}; are {fields} right, and the mass that it moves{more}?"
        return ""


def agreements(data: Measurement, model: mujoco.MjModel) -> Iterator[Agreement]:
    """One for each joint that actuators move, by the rows in which the robot touches nothing.

    None for joints with too few such episodes, or with commands that never change.
    """
    needed, given, episodes = _forces(data, model)
    for joint in range(model.njnt):
        drives = [n for n in _drives(model) if model.actuator_trnid[n, 0] == joint]
        dof = int(model.jnt_dofadr[joint])
        slope = _slope(needed[:, dof], given[:, dof], episodes) if drives else None
        if slope is not None:
            names = tuple(model.actuator(n).name for n in drives)
            yield Agreement(names, model.joint(joint).name, *slope)


def _drives(model: mujoco.MjModel) -> list[int]:
    """Actuators that somebody commands and that move one joint."""
    return [
        number
        for number in range(len(commanded_actuators(model)))
        if model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_JOINT
    ]


def _forces(data: Measurement, model: mujoco.MjModel) -> tuple[Matrix, Matrix, Vector]:
    """(n, nv) forces that the motion takes, and those of the actuators; (n,) their episodes.

    Without the rows in which the robot touches something: forces of contacts move it too.
    """
    period, state = data.period(), mujoco.MjData(model)
    inner = np.concatenate([np.arange(first + 1, last - 1) for first, last in data.spans()])
    needed: list[Vector] = []
    given: list[Vector] = []
    kept: list[int] = []
    for row in inner[:: max(len(inner) // _MOST, 1)].tolist():
        before, now, after = data.qpos[row - 1 : row + 2]
        state.qpos[:] = now
        state.qvel[:] = (after - before) / (2 * period)
        state.ctrl[: data.ctrl.shape[1]] = (data.ctrl[row - 1] + data.ctrl[row]) / 2
        mujoco.mj_forward(model, state)
        if state.ncon:
            continue
        given.append(state.qfrc_actuator.copy())
        state.qacc[:] = (after - 2 * now + before) / period**2
        mujoco.mj_inverse(model, state)
        needed.append(state.qfrc_inverse.copy())
        kept.append(row)
    shape = (len(kept), model.nv)
    episodes = data.episode[kept].astype(np.float64)
    return np.reshape(needed, shape), np.reshape(given, shape), episodes


def _slope(needed: Vector, given: Vector, episodes: Vector) -> tuple[float, float] | None:
    """The slope with its standard error, by the scores of episodes; None: there are too few, or the
    commands never change."""
    numbers = np.unique(episodes)
    drive = given.copy()
    for number in numbers:
        drive[episodes == number] -= drive[episodes == number].mean()
    square = float(drive @ drive)
    is_constant = square <= len(given) * (_ROUNDING * np.abs(given).max(initial=0.0)) ** 2
    if len(numbers) < _FEWEST or is_constant or not np.isfinite(needed).all():
        return None
    slope = float(drive @ needed) / square
    left = drive * (needed - slope * drive)
    scores = np.array([left[episodes == number].sum() for number in numbers])
    count = len(scores)
    return slope, float(np.sqrt(np.sum(scores**2) * count / (count - 1))) / square

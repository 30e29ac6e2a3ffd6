"""Effects outside the catalogue, which a criticism should call unknown."""

from dataclasses import dataclass
from typing import Literal, Protocol

import mujoco
import numpy as np

Outside = Literal[
    "torque_ripple", "cross_coupling", "position_dependent_friction", "gain_drift", "disturbance"
]
# older keys may also have torque ripple and friction by position, which are in the catalogue now
OUTSIDE: tuple[Outside, ...] = ("cross_coupling", "gain_drift", "disturbance")


class Push(Protocol):
    """A force on one degree of freedom of a hidden robot."""

    @property
    def dof(self) -> int: ...

    def at(self, data: mujoco.MjData, seconds: float, length: float) -> float:
        """Generalised force [N or N m] at a moment of the whole recording, asked once in a step."""
        ...


@dataclass(frozen=True)
class Force:
    """An effect outside the catalogue, on one degree of freedom."""

    kind: Outside
    dof: int
    actuator: int
    other: int  # actuator
    size: float

    def at(self, data: mujoco.MjData, seconds: float, length: float) -> float:
        """Generalised force [N or N m] at a moment of the whole recording."""
        position, velocity = data.qpos[self.dof], data.qvel[self.dof]
        match self.kind:
            case "torque_ripple":
                return self.size * float(np.sin(12 * position))
            case "cross_coupling":
                return self.size * float(data.ctrl[self.other])
            case "position_dependent_friction":
                turn = 1 + np.sin(6 * position)
                return -self.size * float(turn * np.tanh(velocity / 0.05))
            case "gain_drift":
                return self.size * float(data.ctrl[self.actuator]) * (seconds / length - 0.5)
            case "disturbance":
                return self.size * float(np.sin(2 * np.pi * 2.7 * seconds))

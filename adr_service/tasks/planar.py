"""Robots that run along x in the vertical plane: Hopper, HalfCheetah and Walker2d.

The first coordinate is x, the second z, the third the torso's angle. Policies do not observe x,
because only the reward depends on it.
"""

from collections.abc import Sequence

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.tasks.base import State


def columns(joints: Sequence[str]) -> tuple[str, ...]:
    """Names of `observe`'s columns: positions without x, then all velocities."""
    angles = ("torso", *joints)
    return (
        "z [m]",
        *(f"{name}_angle [rad]" for name in angles),
        "x_velocity [m/s]",
        "z_velocity [m/s]",
        *(f"{name}_velocity [rad/s]" for name in angles),
    )


def observe(state: State) -> Matrix:
    """Positions without x, then velocities, (n, s)."""
    return np.concatenate([state.qpos[:, 1:], state.qvel], axis=1)


def at_origin(observations: Matrix) -> State:
    """The state of observations (n, s), at x = 0."""
    positions = observations.shape[1] // 2
    x = np.zeros((len(observations), 1))
    return State(
        np.concatenate([x, observations[:, :positions]], axis=1), observations[:, positions:]
    )


def speed(before: State, after: State, control_period_s: float) -> Vector:
    """Mean x velocity over a control step [m/s]."""
    return (after.qpos[:, 0] - before.qpos[:, 0]) / control_period_s

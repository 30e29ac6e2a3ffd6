"""Coulomb friction that depends on what its joint does, which no field of a model says.

    if varies(effects):
        friction = VaryingFriction(batch, model, effects)
        friction.step(4)        # instead of batch.step(nstep=4)

It is worked out anew for each simulator step, from the state and the commands at its start.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch

from adr_service.arrays import Indices, Matrix, Vector
from adr_service.effects.actuators import torques
from adr_service.effects.base import Effect, Turning
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import element_of


def varies(effects: Sequence[Effect]) -> bool:
    """True if some effect is a friction that depends on the state or on commands."""
    return any(get_mechanism(effect.kind).friction is not None for effect in effects)


class VaryingFriction:
    """Effects that change the friction of a batch's simulations at each step."""

    def __init__(self, batch: Batch, model: mujoco.MjModel, effects: Sequence[Effect]):
        """`model`: its drives are those of all simulations."""
        self._batch, self._model, self._effects = batch, model, effects
        self._losses = batch.expand("dof_frictionloss")
        self._own = self._losses.copy()  # without these effects
        self._moment = [batch.bind(name) for name in ("qpos", "qvel", "ctrl")]

    def reset(self, rows: Indices | slice) -> None:
        """Give simulations their own friction, as before a first step."""
        self._losses[rows] = self._own[rows]

    def keep(self, rows: Indices) -> None:
        """Take the present friction of simulations for their own."""
        self._own[rows] = self._losses[rows]

    def step(self, count: int) -> None:
        """Advance all simulations by so many steps."""
        known = self._model, self._effects, self._own
        for _ in range(count):
            self._losses[:] = friction_losses(*known, *self._moment)
            self._batch.step(nstep=1)


def friction_losses(
    model: mujoco.MjModel,
    effects: Sequence[Effect],
    own: Vector | Matrix,
    qpos: Matrix,
    qvel: Matrix,
    ctrl: Matrix,
) -> Matrix:
    """(n, nv) friction of all degrees of freedom in n states under commands (n, nu): `own`, for all
    (nv,) or for each, with what the effects add, and never less than none."""
    losses = np.broadcast_to(own, qvel.shape).copy()
    for effect in effects:
        friction = get_mechanism(effect.kind).friction
        if friction is None:
            continue
        joint = element_of(model, effect.location)
        dof = int(model.jnt_dofadr[joint])
        position = qpos[:, model.jnt_qposadr[joint]]
        turning = Turning(position, torques(model, joint, position, qvel[:, dof], ctrl))
        losses[:, dof] += friction(turning, np.array(effect.values))
    return np.maximum(losses, 0.0)

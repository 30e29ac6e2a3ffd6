"""Coulomb friction that depends on what its joint does; a field of a model has a constant.

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
from adr_service.effects.actuators import torque_of
from adr_service.effects.base import Effect, JointState
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import element_of


def varies(effects: Sequence[Effect]) -> bool:
    """True if some effect is a friction that depends on the state or on commands."""
    return any(get_mechanism(effect.kind).friction is not None for effect in effects)


def uses_torques(effects: Sequence[Effect]) -> bool:
    """True if some effect is a friction that depends on the torque of a joint's drives."""
    frictions = (get_mechanism(effect.kind).friction for effect in effects)
    return any(friction is not None and friction.uses_torques for friction in frictions)


class Losses:
    """Friction of a model's degrees of freedom with effects that change it at each step."""

    def __init__(self, model: mujoco.MjModel, effects: Sequence[Effect]):
        self.own = model.dof_frictionloss.copy()  # (nv,) without these effects
        self._each = [_OnJoint(model, effect) for effect in effects if varies([effect])]

    def at(self, qpos: Matrix, qvel: Matrix, ctrl: Matrix) -> Matrix:
        """(n, nv) friction [N m or N] in n states under commands (n, nu); never less than none."""
        losses = np.tile(self.own, (len(qpos), 1))
        with np.errstate(invalid="ignore"):  # what has diverged is not a number
            for each in self._each:
                losses[:, each.dof] += each.added(qpos, qvel, ctrl)
        return np.maximum(losses, 0.0)


class _OnJoint:
    """One effect on the friction of one joint."""

    def __init__(self, model: mujoco.MjModel, effect: Effect):
        joint, friction = element_of(model, effect.location), get_mechanism(effect.kind).friction
        assert friction is not None
        self._friction, self._values = friction, np.array(effect.values)
        self.dof, self._position = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        self._torque = torque_of(model, joint) if friction.uses_torques else None

    def added(self, qpos: Matrix, qvel: Matrix, ctrl: Matrix) -> Vector:
        position, velocity = qpos[:, self._position], qvel[:, self.dof]
        torque = np.zeros(len(qpos))
        if self._torque is not None:
            torque = self._torque(position, velocity, ctrl)
        return self._friction.added(JointState(position, torque), self._values)


class VaryingFriction:
    """Steps of a batch whose friction is worked out anew at each."""

    def __init__(self, batch: Batch, model: mujoco.MjModel, effects: Sequence[Effect]):
        """`model`: that of all simulations, as far as drives and constant friction go."""
        self._batch, self._losses = batch, Losses(model, effects)
        self._present = batch.expand("dof_frictionloss")
        self._state = [batch.bind(name) for name in ("qpos", "qvel", "ctrl")]

    def reset(self, rows: Indices | slice) -> None:
        """Give simulations the model's own friction, as before a first step."""
        self._present[rows] = self._losses.own

    def step(self, count: int) -> None:
        """Advance all simulations by so many steps."""
        for _ in range(count):
            self._present[:] = self._losses.at(*self._state)
            self._batch.step(nstep=1)

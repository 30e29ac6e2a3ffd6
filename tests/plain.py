"""Plain MuJoCo for comparison: one model, compiled and written without our engine."""

import mujoco
import numpy as np

from adr_service.simulation.model import link_of, resolve
from adr_service.tasks.base import Reshapable


def model_of(task, source, values):
    """The model of one draw: reshaped, compiled, written, and MuJoCo's constants derived."""
    given = {**source.fixed}
    given |= dict(zip([p.address for p in source.space.parameters], values, strict=True))
    spec = mujoco.MjSpec.from_string(task.xml)
    if isinstance(task, Reshapable):
        task.reshape(spec, {link_of(a): v for a, v in given.items() if link_of(a)})
    model = spec.compile()
    for address, value in given.items():
        if link_of(address):
            continue
        slot = resolve(model, address)
        field = getattr(model, slot.field)
        for element in slot.elements:
            if slot.scaled is not None:
                scaled = getattr(model, slot.scaled)
                scaled[element] = value * (scaled[element] / field[element])
            field[element] = value
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def inertial(model, body):
    """Mass, centre and inertia (3, 3) of a body by MuJoCo 2.1.0's rule, from its geoms.

    A capsule counts as a cylinder that is longer by one radius; a sphere is exact.
    """
    parts = []
    for geom in np.flatnonzero(model.geom_bodyid == body):
        radius, length = model.geom_size[geom][0], 2 * model.geom_size[geom][1]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
            mass = 1000 * 4 / 3 * np.pi * radius**3
            moments = np.full(3, 0.4 * mass * radius**2)
        else:
            mass = 1000 * np.pi * radius**2 * (length + radius)
            across = mass * (3 * radius**2 + (length + radius) ** 2) / 12
            moments = np.array([across, across, mass * radius**2 / 2])
        turned = rotation(model.geom_quat[geom])
        parts.append((mass, model.geom_pos[geom], turned @ np.diag(moments) @ turned.T))
    mass = sum(m for m, _, _ in parts)
    centre = sum(m * position for m, position, _ in parts) / mass
    about = np.zeros((3, 3))
    for m, position, moments in parts:
        arm = position - centre
        about += moments + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, centre, about


def rotation(quaternion):
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)

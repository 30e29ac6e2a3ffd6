"""Effects in bodies: their mass, where it is, and what they carry."""

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.effects.base import ADDED, SENSOR_SIZE, Mechanism, Strength

LOADED = f"{ADDED}load_"  # bodies, by body
_REACH = 0.1  # [m] of a body without extent, and of a hand
_GRAVITY = 9.81  # [m/s²] for typical sizes alone


def weight(model: mujoco.MjModel) -> float:
    """Weight of the whole robot on Earth [N]."""
    return float(_GRAVITY * model.body_mass.sum())


def has_mass(model: mujoco.MjModel, body: int) -> bool:
    """True if a body has any mass."""
    return bool(model.body_mass[body] > 0)


def _fiftieth_of_mass(model: mujoco.MjModel, body: int) -> tuple[float, ...]:
    return (0.02 * float(model.body_mass[body]),)


def _mass(model: mujoco.MjModel, body: int, values: Vector) -> None:
    model.body_mass[body] += values[0]


MASS = Mechanism(
    "body_mass",
    "body",
    (Strength("mass", "kg"),),
    typical=_fiftieth_of_mass,
    change=_mass,
    applies=has_mass,
)


def _com(model: mujoco.MjModel, body: int, values: Vector) -> None:
    model.body_ipos[body] += values


CENTRE_OF_MASS = Mechanism(
    "body_com",
    "body",
    (Strength("x", "m"), Strength("y", "m"), Strength("z", "m")),
    typical=lambda model, body: (SENSOR_SIZE,) * 3,
    change=_com,
    applies=has_mass,
    in_force=True,
)


def _inertia(model: mujoco.MjModel, body: int, values: Vector) -> None:
    model.body_inertia[body] *= 1 + values[0]


INERTIA = Mechanism(
    "body_inertia",
    "body",
    (Strength("relative change", "1", low=-1.0),),
    typical=lambda model, body: (0.05,),
    change=_inertia,
    applies=has_mass,
)


def _payload(model: mujoco.MjModel, body: int, values: Vector) -> None:
    """A point mass at the end of the body that is farthest from its origin."""
    mass, at = values[0], _far_end(model, body)
    if mass == 0:
        return
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    frame = rotation.reshape(3, 3)
    own, offset = model.body_mass[body], at - model.body_ipos[body]
    tensor = frame @ np.diag(model.body_inertia[body]) @ frame.T
    reduced = own * mass / (own + mass)  # about the common centre of mass
    tensor += reduced * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    model.body_mass[body] = own + mass
    model.body_ipos[body] += mass / (own + mass) * offset
    quaternion, moments = np.empty(4), np.empty(3)
    mujoco.mju_eig3(moments, np.empty(9), quaternion, tensor.ravel())
    model.body_inertia[body], model.body_iquat[body] = moments, quaternion


def _far_end(model: mujoco.MjModel, body: int) -> Vector:
    """(3,) in the body's frame: the end of its geoms farthest from its origin."""
    ends = [model.body_ipos[body]]
    first = int(model.body_geomadr[body])
    for geom in range(first, first + int(model.body_geomnum[body])):
        centre, halves = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:].copy()
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
            halves[2] = model.geom_size[geom, 1]  # without the cap
        longest = int(np.argmax(halves))
        for side in (-1.0, 1.0):
            end = np.empty(3)
            along = centre + side * halves[longest] * np.eye(3)[longest]
            mujoco.mju_rotVecQuat(end, along, model.geom_quat[geom])
            ends.append(model.geom_pos[geom] + end)
    return max(ends, key=lambda end: float(end @ end))


def _likely_payload(model: mujoco.MjModel, body: int) -> tuple[float, ...]:
    """A quarter of the mass that moves with the robot, or half the body's own if that is more: what
    an arm can carry does not depend on its last link."""
    moves = (model.body_rootid == model.body_rootid[body]) & (model.body_weldid != 0)
    return (max(0.25 * float(model.body_mass[moves].sum()), 0.5 * float(model.body_mass[body])),)


PAYLOAD = Mechanism(
    "payload",
    "body",
    (Strength("mass", "kg", low=0.0),),
    typical=_fiftieth_of_mass,
    likely=_likely_payload,
    change=_payload,
    applies=has_mass,
)


def _add_load(spec: mujoco.MjSpec, body: str) -> None:
    """Add a body without mass, which `_load` fills: what a robot carries is no part of its link,
    whose gravity may be compensated."""
    if spec.body(LOADED + body) is None:
        load = spec.body(body).add_body(name=LOADED + body, explicitinertial=True, ipos=[1, 0, 0])
        load.simple = False


def _load(model: mujoco.MjModel, body: int, values: Vector) -> None:
    """A point mass anywhere, whose first moments (3,) are its place times its mass."""
    if values[0] != 0:
        load = model.body(LOADED + model.body(body).name).id
        present = model.body_mass[load]  # of a model that is extended already
        moments = present * model.body_ipos[load] + values[1:]
        model.body_mass[load] = present + values[0]
        model.body_ipos[load] = moments / model.body_mass[load]


def _typical_load(model: mujoco.MjModel, body: int) -> tuple[float, ...]:
    """A fiftieth of the body's mass, as far from its origin as it reaches, in each direction."""
    (mass,) = _fiftieth_of_mass(model, body)
    reach = float(np.linalg.norm(_far_end(model, body))) or _REACH
    return (mass, *(mass * reach,) * 3)


def _likely_load(model: mujoco.MjModel, body: int) -> tuple[float, ...]:
    """Such a payload, as far from the body's origin as it reaches, or as a hand does."""
    (mass,) = _likely_payload(model, body)
    reach = max(float(np.linalg.norm(_far_end(model, body))), _REACH)
    return (mass, *(mass * reach,) * 3)


LOAD = Mechanism(
    "body_load",
    "body",
    (
        Strength("mass", "kg", low=0.0),
        Strength("moment x", "kg m"),
        Strength("moment y", "kg m"),
        Strength("moment z", "kg m"),
    ),
    typical=_typical_load,
    likely=_likely_load,
    change=_load,
    prepare=_add_load,
    applies=has_mass,
    needs_first=True,
    in_force=True,
)


def _is_compensated(model: mujoco.MjModel, body: int) -> bool:
    return has_mass(model, body) and bool(model.body_gravcomp[body] != 0)


def _compensation(model: mujoco.MjModel, body: int, values: Vector) -> None:
    model.body_gravcomp[body] *= 1 + values[0]


GRAVITY_COMPENSATION = Mechanism(
    "gravity_compensation",
    "body",
    (Strength("relative change", "1"),),
    typical=lambda model, body: (0.01,),
    change=_compensation,
    applies=_is_compensated,
    in_force=True,
)

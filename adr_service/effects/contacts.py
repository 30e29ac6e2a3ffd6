"""Effects at contacts: a geom's own values, and those of the pairs that it is in."""

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.effects.base import Mechanism, Strength


def _pairs(model: mujoco.MjModel, geom: int) -> list[int]:
    return np.flatnonzero((model.pair_geom1 == geom) | (model.pair_geom2 == geom)).tolist()


def _can_touch(model: mujoco.MjModel, geom: int) -> bool:
    meets = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
    return bool(model.geom_bodyid[geom] > 0 and (meets or _pairs(model, geom)))


def _friction(model: mujoco.MjModel, geom: int, values: Vector) -> None:
    model.geom_friction[geom, 0] *= 1 + values[0]
    model.pair_friction[_pairs(model, geom), :2] *= 1 + values[0]


FRICTION = Mechanism(
    "contact_friction",
    "geom",
    (Strength("relative change", "1", low=-1.0),),
    typical=lambda model, geom: (0.1,),
    change=_friction,
    applies=_can_touch,
    sizes=(1.0, -1.0),
    has_sides=True,  # of two geoms the larger friction counts
)


def _softness(model: mujoco.MjModel, geom: int, values: Vector) -> None:
    """Lengthen time constants; a `solref` that is a stiffness and a damping, negative, has none."""
    if model.geom_solref[geom, 0] > 0:
        model.geom_solref[geom, 0] *= 1 + values[0]
    for pair in _pairs(model, geom):
        if model.pair_solref[pair, 0] > 0:
            model.pair_solref[pair, 0] *= 1 + values[0]


def _has_time_constant(model: mujoco.MjModel, geom: int) -> bool:
    own, pairs = model.geom_solref[geom, 0] > 0, model.pair_solref[_pairs(model, geom), 0] > 0
    return _can_touch(model, geom) and bool(own or pairs.any())


SOFTNESS = Mechanism(
    "contact_softness",
    "geom",
    (Strength("relative change of the time constant", "1", low=-1.0),),
    typical=lambda model, geom: (0.1,),
    change=_softness,
    applies=_has_time_constant,
    sizes=(1.0, -5.0, 5.0, 20.0),  # a large change makes outliers of the few touches
)


def _margin(model: mujoco.MjModel, geom: int, values: Vector) -> None:
    model.geom_margin[geom] += values[0]
    model.pair_margin[_pairs(model, geom)] += values[0]


MARGIN = Mechanism(
    "contact_margin",
    "geom",
    (Strength("margin", "m"),),
    typical=lambda model, geom: (0.0005,),
    change=_margin,
    applies=_can_touch,
    sizes=(1.0, -1.0, 2.0, -2.0),  # more of it makes contacts, less ends them
)

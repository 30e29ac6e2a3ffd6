"""Effects from outside the robot: gravity, drag, wind, and a constant force on a body."""

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.effects.actuators import add_passive
from adr_service.effects.base import ADDED, Mechanism, Strength
from adr_service.effects.bodies import has_mass, weight

HOLD = f"{ADDED}force_"  # actuators and sites, by body


def _tilt(model: mujoco.MjModel, element: int, values: Vector) -> None:
    pitch, roll = values
    down = model.opt.gravity.copy()
    about_y = np.array(
        [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    )
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    )
    model.opt.gravity = about_x @ about_y @ down


GRAVITY_TILT = Mechanism(
    "gravity_tilt",
    "global",
    (Strength("pitch", "rad"), Strength("roll", "rad")),
    typical=lambda model, element: (0.01, 0.01),
    change=_tilt,
    in_force=True,
)


def _magnitude(model: mujoco.MjModel, element: int, values: Vector) -> None:
    model.opt.gravity = model.opt.gravity * (1 + values[0])


GRAVITY_MAGNITUDE = Mechanism(
    "gravity_magnitude",
    "global",
    (Strength("relative change", "1"),),
    typical=lambda model, element: (0.01,),
    change=_magnitude,
)


def _drag(model: mujoco.MjModel, element: int, values: Vector) -> None:
    model.opt.density += values[0]


FLUID_DRAG = Mechanism(
    "fluid_drag",
    "global",
    (Strength("density", "kg/m³", low=0.0),),
    typical=lambda model, element: (1.2,),
    change=_drag,
)


def _wind(model: mujoco.MjModel, element: int, values: Vector) -> None:
    model.opt.density += values[0]
    model.opt.wind = model.opt.wind + np.array([values[1], values[2], 0.0])


WIND = Mechanism(
    "wind",
    "global",
    (
        Strength("density", "kg/m³", low=0.0),
        Strength("speed x", "m/s"),
        Strength("speed y", "m/s"),
    ),
    typical=lambda model, element: (1.2, 1.0, 1.0),
    change=_wind,
    includes="fluid_drag",
)


def _add_force(spec: mujoco.MjSpec, body: str) -> None:
    """Add a site at the model's own centre of mass, and an actuator that pushes it, in the world's
    frame."""
    name, world = HOLD + body, HOLD + "world"
    if spec.actuator(name) is not None:
        return
    compiled = spec.compile()
    if spec.site(world) is None:
        spec.worldbody.add_site(name=world)
    spec.body(body).add_site(name=name, pos=compiled.body(body).ipos)
    actuator = add_passive(spec, name, name, mujoco.mjtTrn.mjTRN_SITE)
    actuator.refsite = world
    actuator.biasprm = [1.0, *[0.0] * (len(actuator.biasprm) - 1)]
    actuator.gear = np.zeros(6)


def _can_be_pushed(model: mujoco.MjModel, body: int) -> bool:
    """True unless the sum of a joint's actuators is limited, which would limit the force too."""
    return has_mass(model, body) and not model.jnt_actfrclimited.any()


def _force(model: mujoco.MjModel, body: int, values: Vector) -> None:
    actuator = model.actuator(HOLD + model.body(body).name).id
    model.actuator_gear[actuator, :3] += values


EXTERNAL_FORCE = Mechanism(
    "external_force",
    "body",
    (Strength("x", "N"), Strength("y", "N"), Strength("z", "N")),
    typical=lambda model, body: (0.01 * weight(model),) * 3,
    change=_force,
    prepare=_add_force,
    applies=_can_be_pushed,
    in_force=True,
)

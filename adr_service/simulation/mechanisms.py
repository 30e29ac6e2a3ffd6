"""The physical effects that a simulator may lack, one by one: what each changes, and by how much.

    cause = Cause("joint_coulomb_friction", "joint:leg_joint", (2.0,))
    model = with_causes(spec, lambda model: None, [cause])        # a compiled MjModel

A mechanism acts in one of three ways. Most change fields of the compiled model; those that need
an element of their own get it at zero strength first (`prepare`). Some transform the commands on
their way to the actuators, and some what sensors show. Zero strength is no effect, to the bit.
A target hides mechanisms, criticism finds them, and both use what stands here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.causes import Cause
from adr_service.errors import InvalidInput, UnknownName

Place = Literal["joint", "actuator", "body", "geom", "sensor", "global"]
_OF_SLIDES = {
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "kg m²": "kg",
    "rad": "m",
    "rad/s": "m/s",
}
_Inferred = mujoco.mjtInertiaFromGeom
_BRAKE, _HOLD = "adr_brake_", "adr_force_"  # names of elements that mechanisms add
_GRAVITY = 9.81  # [m/s²] for typical sizes alone


@dataclass(frozen=True)
class Strength:
    """One parameter of a mechanism; at zero it has no effect."""

    name: str
    unit: str
    low: float = -np.inf  # smallest value that makes sense


Change = Callable[[mujoco.MjModel, int, Vector], None]
Prepare = Callable[[mujoco.MjSpec, str], None]
Typical = Callable[[mujoco.MjModel, int], tuple[float, ...]]
Command = Callable[["Commands", int, Vector], Matrix]
Where = Callable[[mujoco.MjModel, int], bool]


@dataclass(frozen=True)
class Commands:
    """What an actuator was told, at every simulator step of every recorded episode."""

    values: Matrix  # (episodes, T) in units of control; after an episode's end, its last
    timestep: float  # [s]
    largest: float  # what the actuator obeys at most


@dataclass(frozen=True)
class Mechanism:
    """A kind of effect. Exactly one of `change`, `command` and `sense` says what it does."""

    kind: str
    place: Place
    strengths: tuple[Strength, ...]
    typical: Typical  # sizes that a sensible simulator might lack, of the strengths
    change: Change | None = None
    prepare: Prepare | None = None
    command: Command | None = None
    sense: Literal["bias", "scale", "delay", "backlash"] | None = None
    applies: Where = lambda model, element: True  # whether it makes sense at a place
    sizes: tuple[float, ...] = (1.0,)  # times typical, where effects are not in proportion
    has_sides: bool = False  # whether more and less of it are effects of their own

    def locations(self, model: mujoco.MjModel) -> list[str]:
        """Where in a model the effect may be."""
        if self.place == "global":
            return ["global"]
        if self.place == "sensor":
            return [f"sensor:{name}" for name in sensors(model)]
        count = {
            "joint": model.njnt,
            "actuator": model.nu,
            "body": model.nbody,
            "geom": model.ngeom,
        }
        first = 1 if self.place == "body" else 0  # the world is no body
        return [
            f"{self.place}:{getattr(model, self.place)(i).name}"
            for i in range(first, count[self.place])
            if self.applies(model, i) and not is_added(getattr(model, self.place)(i).name)
        ]


def sensors(model: mujoco.MjModel) -> list[str]:
    """The measured columns: positions, then velocities, by joint."""
    names = [model.joint(int(model.dof_jntid[dof])).name for dof in range(model.nv)]
    return [f"{n}.position" for n in names] + [f"{n}.velocity" for n in names]


def unit_of(model: mujoco.MjModel, location: str, unit: str) -> str:
    """A strength's unit at a place: catalogue units are those of hinges."""
    place, _, name = location.partition(":")
    joint = name.rpartition(".")[0] if place == "sensor" else name
    if place == "actuator":
        joint = model.joint(int(model.actuator_trnid[model.actuator(name).id, 0])).name
    is_slide = place in ("joint", "actuator", "sensor") and (
        model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    )
    if unit == "of the sensor":
        unit = "rad/s" if name.endswith(".velocity") else "rad"
    return _OF_SLIDES.get(unit, unit) if is_slide else unit


def with_causes(
    spec: mujoco.MjSpec, write: Callable[[mujoco.MjModel], None], causes: Sequence[Cause]
) -> mujoco.MjModel:
    """A compiled model with causes on top of what `write` puts into it.

    The spec gets the elements that the causes need, and may be told the model by `copy_back`.
    """
    model = prepared(spec, causes)
    write(model)
    apply(model, causes)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def prepared(spec: mujoco.MjSpec, causes: Sequence[Cause]) -> mujoco.MjModel:
    """The compiled model with the elements that the causes need, at zero strength."""
    for cause in causes:
        mechanism = get_mechanism(cause.kind)
        if mechanism.prepare is not None:
            mechanism.prepare(spec, cause.name)
    try:
        return spec.compile()
    except ValueError as error:
        raise InvalidInput(f"MuJoCo cannot compile the model: {error}") from error


def apply(model: mujoco.MjModel, causes: Sequence[Cause]) -> None:
    """Change a prepared model by causes; derived constants are the caller's."""
    for cause in causes:
        mechanism = get_mechanism(cause.kind)
        if mechanism.change is not None:
            mechanism.change(model, element_of(model, cause.location), np.array(cause.values))


def openly(spec: mujoco.MjSpec) -> None:
    """Let a model's bodies take causes: their inertias written out, and none of them shortened."""
    inferred = spec.compiler.inertiafromgeom == _Inferred.mjINERTIAFROMGEOM_TRUE
    spec.compiler.inertiafromgeom = _Inferred.mjINERTIAFROMGEOM_AUTO
    for body in spec.bodies[1:]:
        body.simple = False  # such bodies keep their centre of mass where it is
        if inferred or not body.explicitinertial:
            body.explicitinertial = False
            spec.adopt_inertial(body)  # so that a cause may change it
    spec.compiler.inertiafromgeom = _Inferred.mjINERTIAFROMGEOM_FALSE


def check_simulated(model: mujoco.MjModel, causes: Sequence[Cause]) -> None:
    """Raises InvalidInput unless each is an effect in the model itself, at a place it has."""
    for number, cause in enumerate(causes):
        if (cause.kind, cause.location) in [(c.kind, c.location) for c in causes[:number]]:
            raise InvalidInput(f"{cause.kind} at {cause.location} is given twice; give it once")
        mechanism = get_mechanism(cause.kind)
        if mechanism.change is None:
            possible = [kind for kind, each in MECHANISMS.items() if each.change is not None]
            raise InvalidInput(
                f"{cause.kind} acts on commands or in sensors, which simulations that train "
                f"policies do not replay; accepted: {', '.join(possible)}"
            )
        if cause.location not in mechanism.locations(model):
            raise UnknownName(f"place of {cause.kind}", cause.location, mechanism.locations(model))
        lows = [strength.low for strength in mechanism.strengths]
        if len(cause.values) != len(lows) or any(
            not np.isfinite(v) or v < low for v, low in zip(cause.values, lows, strict=True)
        ):
            names = [f"{s.name} [{s.unit}], {s.low:g} at least" for s in mechanism.strengths]
            raise InvalidInput(f"{cause.kind} takes {', '.join(names)}; given {list(cause.values)}")


def is_added(name: str) -> bool:
    """Whether an element is one that a mechanism added; nobody commands such an actuator."""
    return name.startswith((_BRAKE, _HOLD))


def element_of(model: mujoco.MjModel, location: str) -> int:
    """The number of the element that a location names; 0 for what is global."""
    place, _, name = location.partition(":")
    if place == "global":
        return 0
    if place == "sensor":
        names = sensors(model)
        if name not in names:
            raise UnknownName("sensor", name, names)
        return names.index(name)
    try:
        return int(getattr(model, place)(name).id)
    except (KeyError, AttributeError) as error:
        raise InvalidInput(f"the model has no {location!r}: {error}") from error


def get_mechanism(kind: str) -> Mechanism:
    """Raises UnknownName with the kinds there are."""
    if kind not in MECHANISMS:
        raise UnknownName("mechanism", kind, list(MECHANISMS))
    return MECHANISMS[kind]


# Joints: the first degree of freedom of each


def _dof(model: mujoco.MjModel, joint: int) -> int:
    return int(model.jnt_dofadr[joint])


def _drives(model: mujoco.MjModel, joint: int) -> list[int]:
    """Actuators on a joint."""
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    return np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint)).tolist()


def _is_driven(model: mujoco.MjModel, joint: int) -> bool:
    return bool(_drives(model, joint))


def _torque(model: mujoco.MjModel, joint: int) -> float:
    """A hundredth of the largest force of a joint's actuators, or of the robot's weight."""
    drives = _drives(model, joint)
    return 0.01 * sum(_largest_force(model, i) for i in drives) or 0.01 * _weight(model)


def _largest_force(model: mujoco.MjModel, actuator: int) -> float:
    """Of an actuator, after its gear."""
    gain = abs(model.actuator_gear[actuator, 0] * model.actuator_gainprm[actuator, 0])
    return float(gain * _largest_command(model, actuator))


def _largest_command(model: mujoco.MjModel, actuator: int) -> float:
    """In units of control; one where an actuator has no limit."""
    limited = bool(model.actuator_ctrllimited[actuator])
    return float(np.abs(model.actuator_ctrlrange[actuator]).max()) if limited else 1.0


def _weight(model: mujoco.MjModel) -> float:
    return float(_GRAVITY * model.body_mass.sum())


def _inertia(model: mujoco.MjModel, joint: int) -> float:
    return float(model.dof_M0[_dof(model, joint)])


def _coulomb(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.dof_frictionloss[_dof(model, joint)] += values[0]


def _viscous(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.dof_damping[_dof(model, joint)] += values[0]


def _add_brake(spec: mujoco.MjSpec, joint: str) -> None:
    """An actuator that can only pull one way; its sign and strength come with `_brake`."""
    if spec.actuator(_BRAKE + joint) is None:
        actuator = _passive(spec, _BRAKE + joint, joint, mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-1e10, 1e10]


def _passive(
    spec: mujoco.MjSpec, name: str, target: str, transmission: mujoco.mjtTrn
) -> mujoco.MjsActuator:
    """An actuator whose force is a bias alone, whatever the model's defaults are."""
    actuator = spec.add_actuator(name=name, target=target)
    actuator.trntype = transmission
    actuator.dyntype, actuator.actdim = mujoco.mjtDyn.mjDYN_NONE, 0
    actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm, actuator.biasprm = (
        np.zeros_like(actuator.gainprm),
        np.zeros_like(actuator.biasprm),
    )
    for limited in ("ctrllimited", "forcelimited", "actlimited"):
        setattr(actuator, limited, mujoco.mjtLimited.mjLIMITED_FALSE)
    actuator.nsample = 0
    return actuator


def _brake(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    """Damping of one direction: of positive velocities for positive values, else of negative."""
    if values[0] == 0:
        return
    actuator = model.actuator(_BRAKE + model.joint(joint).name).id
    model.actuator_biasprm[actuator, 2] = -abs(values[0])
    model.actuator_forcerange[actuator] = (-1e10, 0.0) if values[0] > 0 else (0.0, 1e10)


def _spring(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.jnt_stiffness[joint] += values[0]


def _reference(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.qpos0[model.jnt_qposadr[joint]] -= values[0]


def _armature(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.dof_armature[_dof(model, joint)] += values[0]


# Actuators


def _gain(model: mujoco.MjModel, actuator: int, values: Vector) -> None:
    model.actuator_gainprm[actuator] *= 1 + values[0]
    model.actuator_biasprm[actuator] *= 1 + values[0]


def _add_bias(spec: mujoco.MjSpec, actuator: str) -> None:
    drive = spec.actuator(actuator)
    if drive.biastype == mujoco.mjtBias.mjBIAS_NONE:
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.biasprm = np.zeros_like(drive.biasprm)


def _bias(model: mujoco.MjModel, actuator: int, values: Vector) -> None:
    model.actuator_biasprm[actuator, 0] += values[0] / model.actuator_gear[actuator, 0]


def delayed(commands: Commands, seconds: float) -> Matrix:
    """Commands `seconds` late, averaged over each simulator step; zero before an episode."""
    steps = seconds / commands.timestep
    whole = int(steps)
    part, before = steps - whole, np.zeros((len(commands.values), whole + 1))
    known = np.concatenate([before, commands.values], axis=1)
    count = commands.values.shape[1]
    return (1 - part) * known[:, 1 : count + 1] + part * known[:, :count]


def _delay(commands: Commands, actuator: int, values: Vector) -> Matrix:
    return delayed(commands, values[0])


def _lag(commands: Commands, actuator: int, values: Vector) -> Matrix:
    """First order, exact for commands that hold during a simulator step; at rest at first."""
    if values[0] <= 0:
        return commands.values
    keep = np.exp(-commands.timestep / values[0])
    # the actuator's mean during a step, from its state at the step's start
    weight = values[0] / commands.timestep * (1 - keep)
    output, state = np.empty_like(commands.values), np.zeros(len(commands.values))
    for step, told in enumerate(commands.values.T):
        output[:, step] = told + (state - told) * weight
        state = told + (state - told) * keep
    return output


def _deadband(commands: Commands, actuator: int, values: Vector) -> Matrix:
    told = commands.values
    return np.sign(told) * np.maximum(np.abs(told) - values[0], 0.0)


def _saturation(commands: Commands, actuator: int, values: Vector) -> Matrix:
    most = commands.largest - values[0]
    return np.clip(commands.values, -most, most)


def _turns_a_joint(model: mujoco.MjModel, actuator: int) -> bool:
    on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    return bool(on_joint and model.actuator_gear[actuator, 0] != 0)


def _is_limited(model: mujoco.MjModel, actuator: int) -> bool:
    return bool(model.actuator_ctrllimited[actuator])


# Bodies


def _mass(model: mujoco.MjModel, body: int, values: Vector) -> None:
    model.body_mass[body] += values[0]


def _com(model: mujoco.MjModel, body: int, values: Vector) -> None:
    model.body_ipos[body] += values


def _body_inertia(model: mujoco.MjModel, body: int, values: Vector) -> None:
    model.body_inertia[body] *= 1 + values[0]


def _payload(model: mujoco.MjModel, body: int, values: Vector) -> None:
    """A point mass at the end of the body that is farthest from its joint."""
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


def _add_force(spec: mujoco.MjSpec, body: str) -> None:
    """A site at the centre of mass and an actuator that pushes it in the world's frame."""
    name = _HOLD + body
    if spec.actuator(name) is None:
        compiled = spec.compile()
        spec.worldbody.add_site(name=_HOLD + "world") if spec.site(
            _HOLD + "world"
        ) is None else None
        spec.body(body).add_site(name=name, pos=compiled.body(body).ipos)
        actuator = _passive(spec, name, name, mujoco.mjtTrn.mjTRN_SITE)
        actuator.refsite = _HOLD + "world"
        actuator.biasprm = [1.0, *[0.0] * (len(actuator.biasprm) - 1)]
        actuator.gear = np.zeros(6)


def _force(model: mujoco.MjModel, body: int, values: Vector) -> None:
    actuator = model.actuator(_HOLD + model.body(body).name).id
    model.actuator_gear[actuator, :3] += values


def _has_mass(model: mujoco.MjModel, body: int) -> bool:
    return bool(model.body_mass[body] > 0)


# Everything


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


def _magnitude(model: mujoco.MjModel, element: int, values: Vector) -> None:
    model.opt.gravity = model.opt.gravity * (1 + values[0])


def _drag(model: mujoco.MjModel, element: int, values: Vector) -> None:
    model.opt.density += values[0]


def _wind(model: mujoco.MjModel, element: int, values: Vector) -> None:
    model.opt.density += values[0]
    model.opt.wind = model.opt.wind + np.array([values[1], values[2], 0.0])


# Contacts: a geom's own values, and those of the pairs that it is in


def _pairs(model: mujoco.MjModel, geom: int) -> list[int]:
    return np.flatnonzero((model.pair_geom1 == geom) | (model.pair_geom2 == geom)).tolist()


def _can_touch(model: mujoco.MjModel, geom: int) -> bool:
    meets = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
    return bool(model.geom_bodyid[geom] > 0 and (meets or _pairs(model, geom)))


def _contact_friction(model: mujoco.MjModel, geom: int, values: Vector) -> None:
    model.geom_friction[geom, 0] *= 1 + values[0]
    model.pair_friction[_pairs(model, geom), :2] *= 1 + values[0]


def _softness(model: mujoco.MjModel, geom: int, values: Vector) -> None:
    model.geom_solref[geom, 0] *= 1 + values[0]
    model.pair_solref[_pairs(model, geom), 0] *= 1 + values[0]


def _margin(model: mujoco.MjModel, geom: int, values: Vector) -> None:
    model.geom_margin[geom] += values[0]
    model.pair_margin[_pairs(model, geom)] += values[0]


_SENSOR_SIZE = 0.005  # [rad, m, rad/s or m/s]
_ALL: tuple[Mechanism, ...] = (
    Mechanism(
        "joint_coulomb_friction",
        "joint",
        (Strength("friction", "N m", low=0.0),),
        lambda model, joint: (_torque(model, joint),),
        _coulomb,
    ),
    Mechanism(
        "joint_viscous_friction",
        "joint",
        (Strength("damping", "N m s/rad"),),
        lambda model, joint: (_torque(model, joint),),
        _viscous,
    ),
    Mechanism(
        "joint_asymmetric_viscous_friction",
        "joint",
        (Strength("damping", "N m s/rad"),),
        lambda model, joint: (_torque(model, joint),),
        _brake,
        _add_brake,
        sizes=(1.0, -1.0),
        has_sides=True,
    ),
    Mechanism(
        "joint_spring",
        "joint",
        (Strength("stiffness", "N m/rad"),),
        lambda model, joint: (_torque(model, joint),),
        _spring,
    ),
    Mechanism(
        "joint_reference_offset",
        "joint",
        (Strength("offset", "rad"),),
        lambda model, joint: (_SENSOR_SIZE,),
        _reference,
        applies=_is_driven,
    ),
    Mechanism(
        "joint_armature",
        "joint",
        (Strength("armature", "kg m²"),),
        lambda model, joint: (0.05 * _inertia(model, joint),),
        _armature,
        applies=_is_driven,
    ),
    Mechanism(
        "joint_backlash",
        "joint",
        (Strength("gap", "rad", low=0.0),),
        lambda model, joint: (_SENSOR_SIZE,),
        sense="backlash",
        applies=_is_driven,
    ),
    Mechanism(
        "actuator_gain",
        "actuator",
        (Strength("relative change", "1", low=-1.0),),
        lambda model, actuator: (0.02,),
        _gain,
    ),
    Mechanism(
        "actuator_bias",
        "actuator",
        (Strength("force", "N m"),),
        lambda model, actuator: (0.01 * _largest_force(model, actuator),),
        _bias,
        _add_bias,
        applies=_turns_a_joint,
    ),
    Mechanism(
        "actuator_delay",
        "actuator",
        (Strength("delay", "s", low=0.0),),
        lambda model, actuator: (0.5 * model.opt.timestep,),
        command=_delay,
    ),
    Mechanism(
        "actuator_lag",
        "actuator",
        (Strength("time constant", "s", low=0.0),),
        lambda model, actuator: (model.opt.timestep,),
        command=_lag,
    ),
    Mechanism(
        "actuator_deadband",
        "actuator",
        (Strength("half width", "control", low=0.0),),
        lambda model, actuator: (0.03 * _largest_command(model, actuator),),
        command=_deadband,
        sizes=(0.3, 1.0, 4.0),
    ),
    Mechanism(
        "actuator_saturation",
        "actuator",
        (Strength("lost range", "control", low=0.0),),
        lambda model, actuator: (0.1 * _largest_command(model, actuator),),
        command=_saturation,
        sizes=(0.3, 1.0, 4.0),
        applies=_is_limited,
    ),
    Mechanism(
        "body_mass",
        "body",
        (Strength("mass", "kg"),),
        lambda model, body: (0.02 * float(model.body_mass[body]),),
        _mass,
        applies=_has_mass,
    ),
    Mechanism(
        "body_com",
        "body",
        (Strength("x", "m"), Strength("y", "m"), Strength("z", "m")),
        lambda model, body: (_SENSOR_SIZE,) * 3,
        _com,
        applies=_has_mass,
    ),
    Mechanism(
        "body_inertia",
        "body",
        (Strength("relative change", "1", low=-1.0),),
        lambda model, body: (0.05,),
        _body_inertia,
        applies=_has_mass,
    ),
    Mechanism(
        "payload",
        "body",
        (Strength("mass", "kg", low=0.0),),
        lambda model, body: (0.02 * float(model.body_mass[body]),),
        _payload,
        applies=_has_mass,
    ),
    Mechanism(
        "gravity_tilt",
        "global",
        (Strength("pitch", "rad"), Strength("roll", "rad")),
        lambda model, element: (0.01, 0.01),
        _tilt,
    ),
    Mechanism(
        "gravity_magnitude",
        "global",
        (Strength("relative change", "1"),),
        lambda model, element: (0.01,),
        _magnitude,
    ),
    Mechanism(
        "fluid_drag",
        "global",
        (Strength("density", "kg/m³", low=0.0),),
        lambda model, element: (1.2,),
        _drag,
    ),
    Mechanism(
        "wind",
        "global",
        (
            Strength("density", "kg/m³", low=0.0),
            Strength("speed x", "m/s"),
            Strength("speed y", "m/s"),
        ),
        lambda model, element: (1.2, 1.0, 1.0),
        _wind,
    ),
    Mechanism(
        "external_force",
        "body",
        (Strength("x", "N"), Strength("y", "N"), Strength("z", "N")),
        lambda model, body: (0.01 * _weight(model),) * 3,
        _force,
        _add_force,
        applies=_has_mass,
    ),
    Mechanism(
        "contact_friction",
        "geom",
        (Strength("relative change", "1", low=-1.0),),
        lambda model, geom: (0.1,),
        _contact_friction,
        applies=_can_touch,
        sizes=(1.0, -1.0),
        has_sides=True,  # of two geoms the larger friction counts
    ),
    Mechanism(
        "contact_softness",
        "geom",
        (Strength("relative change of the time constant", "1", low=-1.0),),
        lambda model, geom: (0.1,),
        _softness,
        applies=_can_touch,
    ),
    Mechanism(
        "contact_margin",
        "geom",
        (Strength("margin", "m"),),
        lambda model, geom: (0.0005,),
        _margin,
        applies=_can_touch,
        sizes=(1.0, -1.0),  # more of it makes contacts, less ends them
    ),
    Mechanism(
        "sensor_bias",
        "sensor",
        (Strength("bias", "of the sensor"),),
        lambda model, sensor: (_SENSOR_SIZE,),
        sense="bias",
    ),
    Mechanism(
        "sensor_scale",
        "sensor",
        (Strength("relative change", "1", low=-1.0),),
        lambda model, sensor: (0.01,),
        sense="scale",
    ),
    Mechanism(
        "sensor_delay",
        "sensor",
        (Strength("delay", "s", low=0.0),),
        lambda model, sensor: (0.5 * model.opt.timestep,),
        sense="delay",
    ),
)
MECHANISMS: dict[str, Mechanism] = {mechanism.kind: mechanism for mechanism in _ALL}

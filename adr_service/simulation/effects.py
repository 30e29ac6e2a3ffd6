"""The catalogue of mechanisms: each physical effect, and what it changes."""

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.simulation.mechanism import BRAKE, HOLD, RELEASE, Commands, Mechanism, Strength

_GRAVITY = 9.81  # [m/s²] for typical sizes alone

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
    _add_limited(spec, BRAKE + joint, joint)


def _add_limited(spec: mujoco.MjSpec, name: str, joint: str) -> None:
    """An actuator of limited force on a joint, unless it is there already."""
    if spec.actuator(name) is None:
        actuator = _passive(spec, name, joint, mujoco.mjtTrn.mjTRN_JOINT)
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
    actuator = model.actuator(BRAKE + model.joint(joint).name).id
    model.actuator_biasprm[actuator, 2] = -abs(values[0])
    model.actuator_forcerange[actuator] = (-1e10, 0.0) if values[0] > 0 else (0.0, 1e10)


def _add_release(spec: mujoco.MjSpec, joint: str) -> None:
    """An actuator that takes friction back with velocity, as much as there is.

    Its gain, which no command meets, keeps MuJoCo from taking its slope for a damping ratio.
    """
    _add_limited(spec, RELEASE + joint, joint)
    spec.actuator(RELEASE + joint).gainprm[0] = 1.0


def _stribeck(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    """Friction at rest that falls to nothing in proportion to velocity: a triangle in place of
    Stribeck's exponential, which MJCF cannot say. Steps stay stable: rest is a constraint."""
    friction, fall = values
    if friction == 0:
        return
    actuator = model.actuator(RELEASE + model.joint(joint).name).id
    model.dof_frictionloss[_dof(model, joint)] += friction
    model.actuator_biasprm[actuator, 2] = fall
    model.actuator_forcerange[actuator] = (-friction, friction)


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
    name = HOLD + body
    if spec.actuator(name) is None:
        compiled = spec.compile()
        spec.worldbody.add_site(name=HOLD + "world") if spec.site(HOLD + "world") is None else None
        spec.body(body).add_site(name=name, pos=compiled.body(body).ipos)
        actuator = _passive(spec, name, name, mujoco.mjtTrn.mjTRN_SITE)
        actuator.refsite = HOLD + "world"
        actuator.biasprm = [1.0, *[0.0] * (len(actuator.biasprm) - 1)]
        actuator.gear = np.zeros(6)


def _force(model: mujoco.MjModel, body: int, values: Vector) -> None:
    actuator = model.actuator(HOLD + model.body(body).name).id
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
CATALOGUE: tuple[Mechanism, ...] = (
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
        "joint_stribeck_friction",
        "joint",
        (
            Strength("friction at rest", "N m", low=0.0),
            Strength("fall", "N m s/rad", low=0.0),  # with velocity; friction / fall: Stribeck's
        ),
        lambda model, joint: (_torque(model, joint), _torque(model, joint)),
        _stribeck,
        _add_release,
        includes="joint_coulomb_friction",
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
        includes="fluid_drag",
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
        sizes=(1.0, -1.0, 2.0, -2.0),  # more of it makes contacts, less ends them
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
    Mechanism(
        "sensor_quantisation",
        "sensor",
        (Strength("step", "of the sensor", low=0.0),),
        lambda model, sensor: (_SENSOR_SIZE,),
        sense="quantisation",
    ),
    Mechanism(
        "sensor_noise",
        "sensor",
        (Strength("standard deviation", "of the sensor", low=0.0),),
        lambda model, sensor: (_SENSOR_SIZE,),
        sense="noise",
    ),
)

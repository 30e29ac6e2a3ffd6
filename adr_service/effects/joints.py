"""Effects at joints: friction, springs, inertia of the drive, play. First degree of freedom."""

from itertools import count

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.effects.actuators import add_passive, drives, has_plain_drives, largest_force
from adr_service.effects.base import (
    ADDED,
    SENSOR_SIZE,
    Friction,
    JointState,
    Mechanism,
    Motion,
    Sensing,
    Strength,
)
from adr_service.effects.bodies import weight

BRAKE, RELEASE = f"{ADDED}brake_", f"{ADDED}release_"  # actuators, by joint
RIPPLE = f"{ADDED}ripple{{}}_"  # and by number, from 1 on
_UNLIMITED = 1e10
# sizes: what is sensible at one unit of speed or position is huge at a hundred, which wheels have
_ANY_SPEED = (1.0, 1e-2, 1e-4)


def _dof(model: mujoco.MjModel, joint: int) -> int:
    return int(model.jnt_dofadr[joint])


def _position(model: mujoco.MjModel, joint: int) -> list[int]:
    return [_dof(model, joint)]


def _is_driven(model: mujoco.MjModel, joint: int) -> bool:
    return bool(drives(model, joint))


def _torque(model: mujoco.MjModel, joint: int) -> float:
    """A hundredth of the largest force of a joint's actuators, or of the robot's weight."""
    largest = sum(largest_force(model, i) for i in drives(model, joint))
    return 0.01 * largest or 0.01 * weight(model)


def _one_torque(model: mujoco.MjModel, joint: int) -> tuple[float, ...]:
    return (_torque(model, joint),)


def _add_limited(spec: mujoco.MjSpec, name: str, joint: str) -> None:
    """Add an actuator of limited force to a joint, unless it is there already."""
    if spec.actuator(name) is None:
        actuator = add_passive(spec, name, joint, mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-_UNLIMITED, _UNLIMITED]


def _coulomb(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.dof_frictionloss[_dof(model, joint)] += values[0]


COULOMB_FRICTION = Mechanism(
    "joint_coulomb_friction",
    "joint",
    (Strength("friction", "N m", low=0.0),),
    typical=_one_torque,
    change=_coulomb,
    in_force=True,
)


def _viscous(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.dof_damping[_dof(model, joint)] += values[0]


VISCOUS_FRICTION = Mechanism(
    "joint_viscous_friction",
    "joint",
    (Strength("damping", "N m s/rad"),),
    typical=_one_torque,
    change=_viscous,
    in_force=True,
)


def _quadratic(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.dof_dampingpoly[_dof(model, joint), 0] += values[0]


QUADRATIC_FRICTION = Mechanism(
    "joint_quadratic_friction",
    "joint",
    (Strength("drag", "N m s²/rad²"),),
    typical=_one_torque,
    change=_quadratic,
    sizes=_ANY_SPEED,
    in_force=True,
)


def _add_brake(spec: mujoco.MjSpec, joint: str) -> None:
    """Add an actuator that can only pull one way; `_brake` gives it its sign and strength."""
    _add_limited(spec, BRAKE + joint, joint)


def _is_free(model: mujoco.MjModel, joint: int) -> bool:
    """True unless the sum of a joint's actuators is limited, which would limit this one too."""
    return not model.jnt_actfrclimited[joint]


def _brake(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    """Damp one direction: positive velocities for positive values, negative ones otherwise.

    A model that is extended already may brake the other one: what both have is damping.
    """
    actuator, added = model.actuator(BRAKE + model.joint(joint).name).id, values[0]
    brakes_forwards = model.actuator_forcerange[actuator, 1] == 0
    present = -model.actuator_biasprm[actuator, 2] * (1.0 if brakes_forwards else -1.0)
    if added == 0:
        return
    if present * added < 0:
        model.dof_damping[_dof(model, joint)] += min(abs(present), abs(added))
    total = present + added
    model.actuator_biasprm[actuator, 2] = -abs(total)
    model.actuator_forcerange[actuator] = (-_UNLIMITED, 0.0) if total > 0 else (0.0, _UNLIMITED)


ASYMMETRIC_VISCOUS_FRICTION = Mechanism(
    "joint_asymmetric_viscous_friction",
    "joint",
    (Strength("damping", "N m s/rad"),),
    typical=_one_torque,
    change=_brake,
    prepare=_add_brake,
    applies=_is_free,
    sizes=(1.0, -1.0),
    has_sides=True,
)


def _add_release(spec: mujoco.MjSpec, joint: str) -> None:
    """Add an actuator that takes friction back with velocity, as much as there is.

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
    if model.actuator_biasprm[actuator, 2] != 0:  # of a model that is extended already
        friction += model.actuator_forcerange[actuator, 1]
    model.actuator_biasprm[actuator, 2] += fall
    model.actuator_forcerange[actuator] = (-friction, friction)


STRIBECK_FRICTION = Mechanism(
    "joint_stribeck_friction",
    "joint",
    (
        Strength("friction at rest", "N m", low=0.0),
        Strength("fall", "N m s/rad", low=0.0),  # with velocity; friction / fall: Stribeck's
    ),
    typical=lambda model, joint: (_torque(model, joint), _torque(model, joint)),
    change=_stribeck,
    prepare=_add_release,
    applies=_is_free,
    includes="joint_coulomb_friction",
    needs_first=True,
)


def _by_load(state: JointState, values: Vector) -> Vector:
    return values[0] * np.abs(state.torques)


LOAD_DEPENDENT_FRICTION = Mechanism(
    "joint_load_dependent_friction",
    "joint",
    (Strength("share of the drive's torque", "1", low=0.0),),
    typical=lambda model, joint: (0.02,),
    friction=Friction(_by_load, uses_torques=True),
    applies=has_plain_drives,
)


def _spring(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.jnt_stiffness[joint] += values[0]


SPRING = Mechanism(
    "joint_spring",
    "joint",
    (Strength("stiffness", "N m/rad"),),
    typical=_one_torque,
    change=_spring,
    in_force=True,
)


def _cubic_spring(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.jnt_stiffnesspoly[joint, 1] += values[0]


CUBIC_SPRING = Mechanism(
    "joint_cubic_spring",
    "joint",
    (Strength("hardening", "N m/rad³"),),
    typical=_one_torque,
    change=_cubic_spring,
    sizes=_ANY_SPEED,
    in_force=True,
)


def _add_ripple(spec: mujoco.MjSpec, joint: str) -> None:
    """Add a passive actuator with the bias of a motor that cogs, by nothing yet."""
    name = next(
        name
        for number in count(1)
        if (known := spec.actuator(name := RIPPLE.format(number) + joint)) is None
        or known.biasprm[0] == 0
    )
    if spec.actuator(name) is None:
        actuator = add_passive(spec, name, joint, mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        actuator.biastype = mujoco.mjtBias.mjBIAS_DCMOTOR


def _ripple(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    """Cog by sine sin(n q) + cosine cos(n q) at an angle q with n waves in a turn.

    It is beside what an extended model has already, in an actuator that preparation added to this
    model: apply it once.
    """
    sine, cosine, waves = values
    names = (RIPPLE.format(number) + model.joint(joint).name for number in count(1))
    free = next(name for name in names if model.actuator(name).biasprm[0] == 0)
    model.actuator(free).biasprm[:3] = np.hypot(sine, cosine), waves, np.arctan2(cosine, sine)


def _ripple_by_angle(angles: Vector, values: Vector) -> Matrix:
    sine, cosine, waves = values
    turned = waves * angles
    return np.column_stack([sine * np.sin(turned), cosine * np.cos(turned), 0 * angles])


def _turns_and_is_driven(model: mujoco.MjModel, joint: int) -> bool:
    is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    return bool(is_hinge and _is_driven(model, joint))


def _may_ripple(model: mujoco.MjModel, joint: int) -> bool:
    return _turns_and_is_driven(model, joint) and _is_free(model, joint)


TORQUE_RIPPLE = Mechanism(
    "joint_torque_ripple",
    "joint",
    (
        Strength("sine amplitude", "N m"),
        Strength("cosine amplitude", "N m"),
        Strength("waves in a turn", "1", low=0.0, is_shape=True),
    ),
    typical=lambda model, joint: (_torque(model, joint), _torque(model, joint), 2.0),
    change=_ripple,
    prepare=_add_ripple,
    applies=_may_ripple,
    by_angle=_ripple_by_angle,
)


def _friction_by_angle(angles: Vector, values: Vector) -> Matrix:
    mean, *wave = values
    return np.column_stack([mean + 0 * angles, _ripple_by_angle(angles, np.array(wave))])


def _typical_friction(model: mujoco.MjModel, joint: int) -> tuple[float, ...]:
    """Waves that leave some friction everywhere."""
    mean = _torque(model, joint)
    return mean, mean / 2, mean / 2, 2.0


def _by_position(state: JointState, values: Vector) -> Vector:
    return _friction_by_angle(state.positions, values).sum(axis=1)


POSITION_DEPENDENT_FRICTION = Mechanism(
    "joint_position_dependent_friction",
    "joint",
    (
        Strength("mean friction", "N m"),  # may be less than the model's
        Strength("sine amplitude", "N m"),
        Strength("cosine amplitude", "N m"),
        Strength("waves in a turn", "1", low=0.0, is_shape=True),
    ),
    typical=_typical_friction,
    friction=Friction(_by_position),
    applies=_turns_and_is_driven,
    includes="joint_coulomb_friction",
    by_angle=_friction_by_angle,
)


def _reference(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.qpos0[model.jnt_qposadr[joint]] -= values[0]


REFERENCE_OFFSET = Mechanism(
    "joint_reference_offset",
    "joint",
    (Strength("offset", "rad"),),
    typical=lambda model, joint: (SENSOR_SIZE,),
    change=_reference,
    applies=_is_driven,
    sizes=(1.0, 0.01),  # millimetres at a foot that touches, or hundredths of one
)


def _armature(model: mujoco.MjModel, joint: int, values: Vector) -> None:
    model.dof_armature[_dof(model, joint)] += values[0]


def _typical_armature(model: mujoco.MjModel, joint: int) -> tuple[float, ...]:
    """A twentieth of the joint's inertia or of its drive's, whichever is larger; a geared drive has
    about 4 g m² for each N m."""
    inertia = float(model.dof_M0[_dof(model, joint)])
    return (max(0.05 * inertia, 0.02 * _torque(model, joint)),)


ARMATURE = Mechanism(
    "joint_armature",
    "joint",
    (Strength("armature", "kg m²"),),
    typical=_typical_armature,
    change=_armature,
    applies=_is_driven,
    in_force=True,
)


def _play(positions: Matrix, values: Vector, period: float) -> Matrix:
    """The play operator, whose output follows only the edges of the gap that push it."""
    gap = values[0]
    shown, state = np.empty_like(positions), positions[:, 0].copy()
    for row, position in enumerate(positions.T):
        state = np.clip(state, position - gap / 2, position + gap / 2)
        shown[:, row] = state
    return shown


def _behind(motion: Motion, values: Vector) -> Vector:
    """The play operator over the last moments, from the middle of the gap."""
    path = np.column_stack([-motion.past[:, ::-1], np.zeros(len(motion.past))])
    return _play(path, values, np.nan)[:, -1]


BACKLASH = Mechanism(
    "joint_backlash",
    "joint",
    (Strength("gap", "rad", low=0.0),),
    typical=lambda model, joint: (SENSOR_SIZE,),
    sensing=Sensing(_behind, _play, columns=_position, uses_past=True),
    applies=_is_driven,
)

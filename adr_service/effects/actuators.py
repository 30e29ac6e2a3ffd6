"""Effects at actuators: on their force, and on commands on their way to them."""

from collections.abc import Callable
from typing import TypeAlias

import mujoco
import numpy as np

from adr_service.arrays import Mask, Matrix, Vector
from adr_service.effects.base import Commands, Mechanism, Strength, delayed, is_added

# (n,) at n positions and velocities (n,) of a joint, under commands (n, nu)
Torque: TypeAlias = Callable[[Vector, Vector, Matrix], Vector]


def drives(model: mujoco.MjModel, joint: int) -> list[int]:
    """Actuators on a joint, without those that a mechanism added."""
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    found = np.flatnonzero(on_joint & (model.actuator_trnid[:, 0] == joint)).tolist()
    return [number for number in found if not is_added(model.actuator(number).name)]


def has_plain_drives(model: mujoco.MjModel, joint: int) -> bool:
    """True if a hinge or a slide has drives, and `torque_of` knows the force of each."""
    on_joint, kinds = drives(model, joint), mujoco.mjtJoint
    moves = int(model.jnt_type[joint]) in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE))
    disabled = mujoco.mjtDisableBit.mjDSBL_ACTUATION
    is_on = not (model.opt.disableflags & disabled or model.jnt_actgravcomp[joint])
    return moves and bool(on_joint) and is_on and all(_is_plain(model, i) for i in on_joint)


def _is_plain(model: mujoco.MjModel, actuator: int) -> bool:
    is_direct = model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
    is_off = model.opt.disableactuator >> int(model.actuator_group[actuator]) & 1
    return bool(is_direct and not is_off and is_affine(model, actuator))


def torque_of(model: mujoco.MjModel, joint: int) -> Torque:
    """The function that works out the torque [N m or N] of a joint that `has_plain_drives`."""
    numbers = drives(model, joint)
    gear = model.actuator_gear[numbers, 0].copy()
    by_motion = np.stack([np.ones(len(gear)), gear, gear], axis=1)  # constant, position, velocity
    gains, biases = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_AFFINE
    gain = model.actuator_gainprm[numbers, :3] * by_motion
    gain[model.actuator_gaintype[numbers] != gains, 1:] = 0.0
    bias = model.actuator_biasprm[numbers, :3] * by_motion
    bias[model.actuator_biastype[numbers] != biases] = 0.0
    commanded = _bounds(model.actuator_ctrlrange[numbers], obeys_limits(model)[numbers])
    pulled = _bounds(model.actuator_forcerange[numbers], model.actuator_forcelimited[numbers])
    whole = _bounds(model.jnt_actfrcrange[[joint]], model.jnt_actfrclimited[[joint]])

    def torque(position: Vector, velocity: Vector, commands: Matrix) -> Vector:
        motion = np.column_stack([np.ones(len(position)), position, velocity])
        command = np.clip(commands[:, numbers], *commanded)
        force = np.clip(command * (motion @ gain.T) + motion @ bias.T, *pulled)
        return np.clip(force @ gear, *whole)

    return torque


def _bounds(ranges: Matrix, is_limited: Mask) -> tuple[Vector, Vector]:
    """Lower and upper bounds (k,), infinite where there is no limit."""
    low, high = np.where(np.asarray(is_limited, dtype=bool), ranges.T, [[-np.inf], [np.inf]])
    return low, high


def obeys_limits(model: mujoco.MjModel) -> Mask:
    """(nu,) true for actuators whose commands are cut at their limits."""
    is_cut = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    return model.actuator_ctrllimited.astype(bool) & is_cut


def largest_force(model: mujoco.MjModel, actuator: int) -> float:
    """Largest force of an actuator, after its gear, as far as its own and its joint's bounds."""
    gear = abs(float(model.actuator_gear[actuator, 0]))
    force = abs(float(model.actuator_gainprm[actuator, 0])) * _largest_command(model, actuator)
    if model.actuator_forcelimited[actuator]:
        force = min(force, float(np.abs(model.actuator_forcerange[actuator]).max()))
    joint = int(model.actuator_trnid[actuator, 0])
    is_on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    if is_on_joint and model.jnt_actfrclimited[joint]:
        return min(gear * force, float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return gear * force


def _largest_command(model: mujoco.MjModel, actuator: int) -> float:
    """Bound of an actuator's command in units of control; one if it has no limit."""
    limited = bool(model.actuator_ctrllimited[actuator])
    return float(np.abs(model.actuator_ctrlrange[actuator]).max()) if limited else 1.0


def add_passive(
    spec: mujoco.MjSpec, name: str, target: str, transmission: mujoco.mjtTrn
) -> mujoco.MjsActuator:
    """Add an actuator whose force is a bias alone, whatever the model's defaults are."""
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
    actuator.nsample, actuator.delay, actuator.armature = 0, 0.0, 0.0
    actuator.damping = np.zeros_like(actuator.damping)
    return actuator


def is_affine(model: mujoco.MjModel, actuator: int) -> bool:
    """True if its force is a gain times the command and a bias, at most linear in the state."""
    gain, bias = model.actuator_gaintype[actuator], model.actuator_biastype[actuator]
    is_fixed, is_none = gain == mujoco.mjtGain.mjGAIN_FIXED, bias == mujoco.mjtBias.mjBIAS_NONE
    return bool(
        (is_fixed or gain == mujoco.mjtGain.mjGAIN_AFFINE)
        and (is_none or bias == mujoco.mjtBias.mjBIAS_AFFINE)
    )


def obeys_force(model: mujoco.MjModel, actuator: int) -> bool:
    """True if its command is a force, beside which it has a constant at most.

    The command of a servo is a goal, which stays where it is while the drive weakens.
    """
    bias, by_state = model.actuator_biastype[actuator], model.actuator_biasprm[actuator, 1:3]
    is_constant = bias == mujoco.mjtBias.mjBIAS_AFFINE and not by_state.any()
    return bool(bias == mujoco.mjtBias.mjBIAS_NONE or is_constant)


def _gain(model: mujoco.MjModel, actuator: int, values: Vector) -> None:
    model.actuator_gainprm[actuator] *= 1 + values[0]
    model.actuator_biasprm[actuator] *= 1 + values[0]


GAIN = Mechanism(
    "actuator_gain",
    "actuator",
    (Strength("relative change", "1", low=-1.0),),
    typical=lambda model, actuator: (0.02,),
    change=_gain,
    applies=is_affine,
)


def _add_bias(spec: mujoco.MjSpec, actuator: str) -> None:
    drive = spec.actuator(actuator)
    if drive.biastype == mujoco.mjtBias.mjBIAS_NONE:
        drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        drive.biasprm = np.zeros_like(drive.biasprm)


def _bias(model: mujoco.MjModel, actuator: int, values: Vector) -> None:
    model.actuator_biasprm[actuator, 0] += values[0] / model.actuator_gear[actuator, 0]


def _turns_a_joint(model: mujoco.MjModel, actuator: int) -> bool:
    on_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
    turns = bool(on_joint and model.actuator_gear[actuator, 0] != 0)
    return turns and is_affine(model, actuator)


BIAS = Mechanism(
    "actuator_bias",
    "actuator",
    (Strength("force", "N m"),),
    typical=lambda model, actuator: (0.01 * largest_force(model, actuator),),
    change=_bias,
    prepare=_add_bias,
    applies=_turns_a_joint,
    in_force=True,
)


def _delay(commands: Commands, values: Vector) -> Matrix:
    """Late commands, averaged over each simulator step; an episode's first held before it."""
    return delayed(commands.values, values[0] / commands.timestep)


DELAY = Mechanism(
    "actuator_delay",
    "actuator",
    (Strength("delay", "s", low=0.0),),
    typical=lambda model, actuator: (0.5 * model.opt.timestep,),
    command=_delay,
    is_late=True,
)


def _lag(commands: Commands, values: Vector) -> Matrix:
    """First order, exact for commands that hold during a simulator step; it has settled at an
    episode's first command."""
    if values[0] <= 0:
        return commands.values
    keep = np.exp(-commands.timestep / values[0])
    # the actuator's mean during a step, from its state at the step's start
    weight = values[0] / commands.timestep * (1 - keep)
    output, state = np.empty_like(commands.values), commands.values[:, 0]
    for step, command in enumerate(commands.values.T):
        output[:, step] = command + (state - command) * weight
        state = command + (state - command) * keep
    return output


LAG = Mechanism(
    "actuator_lag",
    "actuator",
    (Strength("time constant", "s", low=0.0),),
    typical=lambda model, actuator: (model.opt.timestep,),
    command=_lag,
    is_late=True,
)


def _deadband(commands: Commands, values: Vector) -> Matrix:
    given = commands.values
    return np.sign(given) * np.maximum(np.abs(given) - values[0], 0.0)


DEADBAND = Mechanism(
    "actuator_deadband",
    "actuator",
    (Strength("half width", "control", low=0.0),),
    typical=lambda model, actuator: (0.03 * _largest_command(model, actuator),),
    command=_deadband,
    applies=obeys_force,
    sizes=(0.3, 1.0, 4.0),
)


def _saturation(commands: Commands, values: Vector) -> Matrix:
    most = max(commands.largest - values[0], 0.0)
    return np.clip(commands.values, -most, most)


def _is_limited(model: mujoco.MjModel, actuator: int) -> bool:
    return bool(obeys_limits(model)[actuator])


SATURATION = Mechanism(
    "actuator_saturation",
    "actuator",
    (Strength("lost range", "control", low=0.0),),
    typical=lambda model, actuator: (0.1 * _largest_command(model, actuator),),
    command=_saturation,
    applies=_is_limited,
    sizes=(0.3, 1.0, 4.0),
)


def _fade(commands: Commands, values: Vector) -> Matrix:
    elapsed = commands.timestep * np.arange(commands.values.shape[1])
    return commands.values * np.exp(-values[0] * elapsed)


FADE = Mechanism(
    "actuator_fade",
    "actuator",
    (Strength("loss in an episode", "1/s"),),
    typical=lambda model, actuator: (0.05,),
    command=_fade,
    applies=obeys_force,
)

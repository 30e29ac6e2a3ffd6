"""Effects in sensors: how each moves a reading, how to undo it, and what it records exactly.

A criticism judges single steps, so `offset` may approximate (a delay by the rate of change). A
hidden robot shares no such approximation: its readings come from `record`, in its own fine steps.
"""

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.effects.base import SENSOR_SIZE, Mechanism, Motion, Sensing, Strength, delayed


def _bias(motion: Motion, values: Vector) -> Vector:
    return np.full(len(motion.states), values[0])


def _biased(truth: Matrix, values: Vector, period: float) -> Matrix:
    return truth + values[0]


BIAS = Mechanism(
    "sensor_bias",
    "sensor",
    (Strength("bias", "of the sensor"),),
    typical=lambda model, sensor: (SENSOR_SIZE,),
    sensing=Sensing(_bias, _biased),
)


def _scale(motion: Motion, values: Vector) -> Vector:
    return values[0] * motion.states[:, motion.column]


def _scale_shown(motion: Motion, values: Vector) -> Vector:
    with np.errstate(divide="ignore", invalid="ignore"):  # at -1 nothing is shown: not finite
        return _scale(motion, values) / (1 + values[0])


def _scaled(truth: Matrix, values: Vector, period: float) -> Matrix:
    return truth * (1 + values[0])


SCALE = Mechanism(
    "sensor_scale",
    "sensor",
    (Strength("relative change", "1", low=-1.0),),
    typical=lambda model, sensor: (0.01,),
    sensing=Sensing(_scale, _scaled, offset_shown=_scale_shown),
)


def _position_and_velocity(model: mujoco.MjModel, joint: int) -> list[int]:
    dof = int(model.jnt_dofadr[joint])
    return [dof, model.nv + dof]


ENCODER_SCALE = Mechanism(
    "joint_encoder_scale",
    "joint",
    (Strength("relative change", "1", low=-1.0),),
    typical=lambda model, joint: (0.01,),
    sensing=Sensing(_scale, _scaled, offset_shown=_scale_shown, columns=_position_and_velocity),
)


def _lateness(motion: Motion, values: Vector) -> Vector:
    """By a position's own velocity, and by how fast a velocity has changed meanwhile."""
    velocity = motion.column + motion.states.shape[1] // 2
    is_position = velocity < motion.states.shape[1]
    rate = motion.states[:, velocity] if is_position else motion.rates[:, motion.column]
    return -values[0] * rate


def _late(truth: Matrix, values: Vector, period: float) -> Matrix:
    """Between two readings on a line; an episode's first is held before it."""
    return delayed(truth, values[0] / period)


DELAY = Mechanism(
    "sensor_delay",
    "sensor",
    (Strength("delay", "s", low=0.0),),
    typical=lambda model, sensor: (0.5 * model.opt.timestep,),
    sensing=Sensing(_lateness, _late, window=lambda values: float(values[0])),
)


def _nothing(motion: Motion, values: Vector) -> Vector:
    """The mean of what spreads readings about the truth."""
    return np.zeros(len(motion.states))


QUANTISATION = Mechanism(
    "sensor_quantisation",
    "sensor",
    (Strength("step", "of the sensor", low=0.0),),
    typical=lambda model, sensor: (SENSOR_SIZE,),
    sensing=Sensing(_nothing, record=None),
)
NOISE = Mechanism(
    "sensor_noise",
    "sensor",
    (Strength("standard deviation", "of the sensor", low=0.0),),
    typical=lambda model, sensor: (SENSOR_SIZE,),
    sensing=Sensing(_nothing, record=None),
)

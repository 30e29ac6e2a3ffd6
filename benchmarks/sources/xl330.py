"""XL-330: a servo that drops a pendulum, its torque switched off.

Duclusaud, Passault, Padois and Ly, "Extended friction models for the physics simulation of servo
actuators", ICRA 2025; repository Rhoban/bam, `bam/data.bak/raw`. The `lift_and_drop` logs switch
the torque off after two seconds; from there the pendulum swings freely until friction holds it.
Position [rad] is read some 290 times a second at irregular times, in steps of 2 pi / 4096. The
servo's own speed lags, so that states come from local quadratic fits to the positions, every 30 ms.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace

PERIOD_S = 0.03
_STEP_RAD = 2 * np.pi / 4096
_WINDOW_S = 0.015  # to either side, of a local fit: no reading is in two of them
_PIECE = 26  # transitions
_LEAST_READINGS = 4
_SETTLED_S = 0.3  # after the last motion
_XML = """
<mujoco model="pendulum">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <inertial pos="0 0 -0.1" mass="0.49" diaginertia="1e-6 1e-6 1e-6"/>
      <joint name="servo" axis="0 1 0" armature="0.0018" solreffriction="0.004 1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="servo" joint="servo"/>
  </actuator>
</mujoco>
"""


def nominal() -> Nominal:
    """A pendulum whose drive has inertia and viscous friction, both free."""
    space = ParameterSpace(
        (
            Parameter("armature", "joint:servo.armature", "kg m²", 1e-4, 1e-2, 1e-5),
            Parameter("damping", "joint:servo.damping", "N m s/rad", 0.0, 0.1, 0.0),
        )
    )
    return Nominal.of_model(_XML, space)


def read(files: Sequence[Path]) -> Measurement:
    """The free swings of `lift_and_drop` logs, in pieces of half a second."""
    pieces = [piece for file in files for piece in _pieces(*_swing(file))]
    if not pieces:
        raise InvalidInput(f"no swing is as long as {_PIECE} steps of {PERIOD_S} s")
    states = np.concatenate(pieces)
    return Measurement(
        time=np.tile(PERIOD_S * np.arange(_PIECE + 1, dtype=np.float64), len(pieces)),
        qpos=states[:, :1],
        qvel=states[:, 1:],
        ctrl=np.zeros((len(states), 1)),  # torque off
        episode=np.repeat(np.arange(len(pieces)), _PIECE + 1),
        qpos_std=np.array([_STEP_RAD / np.sqrt(12)]),
    )


def _swing(file: Path) -> tuple[Vector, Vector]:
    """Times and positions from the release to when friction holds the pendulum."""
    try:
        entries = json.loads(file.read_text())["entries"]
        time, position, is_on = (
            np.array([entry[name] for entry in entries], dtype=np.float64)
            for name in ("timestamp", "position", "torque_enable")
        )
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise InvalidInput(f"{file} is no log of a servo: {error}") from error
    free = np.flatnonzero(is_on == 0)
    if not len(free):
        raise InvalidInput(f"{file} never switches the torque off: it is no lift_and_drop")
    time, position = time[free], position[free]
    moved = np.flatnonzero(np.abs(position - position[-1]) > 2 * _STEP_RAD)
    until = time <= time[moved[-1]] + _SETTLED_S if len(moved) else time <= time[0]
    return time[until], position[until]


def _pieces(time: Vector, position: Vector) -> list[Matrix]:
    """(rows, 2) position and velocity at even times, cut into pieces that share their ends."""
    centres = np.arange(time[0] + _WINDOW_S, time[-1] - _WINDOW_S, PERIOD_S)
    states = np.empty((len(centres), 2))
    for row, centre in enumerate(centres):
        near = np.abs(time - centre) <= _WINDOW_S
        if near.sum() < _LEAST_READINGS:
            raise InvalidInput(
                f"{near.sum()} readings within {_WINDOW_S} s of {centre:.3f} s; at least "
                f"{_LEAST_READINGS} are needed for a velocity"
            )
        parabola = np.polynomial.polynomial.polyfit(time[near] - centre, position[near], 2)
        states[row] = parabola[:2]
    count = (len(centres) - 1) // _PIECE
    return [states[k * _PIECE : (k + 1) * _PIECE + 1] for k in range(count)]

"""Feetech STS3250: a geared servo that swings a mass, towards goals that it is given.

Repository Rhoban/bam, `data_raw_feetech` (see `xl330.py` for the paper). Goal and position [rad]
some 49 times a second; the servo's own speed lags, and is left out. Its controller turns towards
the goal with a stiffness and a damping that nobody states. So the torques by the goal and by the
position are free, and so is the damping.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.errors import InvalidInput
from adr_service.logs.base import Log, Stream
from adr_service.logs.conversion import convert
from adr_service.logs.mapping import LogMap
from adr_service.parameters import Parameter, ParameterSpace

_MASS, _LENGTH = 1.13, 0.12  # [kg], [m] by all logs
_STIFFNESS = 20.0  # [N m/rad] to begin with
_COLUMNS = ("timestamp", "position", "goal_position")
_XML = f"""
<mujoco model="servo">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="servo" axis="0 -1 0" armature="0.02" damping="1" stiffness="{_STIFFNESS}"
             solreffriction="0.004 1"/>
      <inertial pos="0 0 {-_LENGTH}" mass="{_MASS}" diaginertia="1e-5 1e-5 1e-5"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="servo" joint="servo" gear="{_STIFFNESS}" ctrlrange="-3.2 3.2"/>
  </actuator>
</mujoco>
"""
_MAP = """
[time]
column = "timestamp"
[rows]
period = 0.02
seconds = 0.6
[joints.servo]
position = "position"
[actuators.servo]
command = "goal_position"
"""


def nominal() -> Nominal:
    """A point mass on a position servo: stiffness, damping and rotor inertia are free."""
    space = ParameterSpace(
        (
            Parameter("armature", "joint:servo.armature", "kg m²", 1e-3, 0.2, 1e-5),
            Parameter("damping", "joint:servo.damping", "N m s/rad", 0.0, 10.0, 0.0),
            Parameter("by goal", "actuator:servo.gear", "N m/rad", 2.0, 200.0, 0.1),
            Parameter("by position", "joint:servo.stiffness", "N m/rad", 2.0, 200.0, 0.1),
        )
    )
    return Nominal.of_model(_XML, space)


def read(files: Sequence[Path]) -> Measurement:
    """The logs whose torque stays on, in episodes of six tenths of a second.

    Raises InvalidInput for other files.
    """
    model = nominal()
    logs = [log for file in files if (log := _log(file)) is not None]
    return convert(logs, LogMap.from_toml(_MAP), model.model(model.start)).measurement


def _log(file: Path) -> Log | None:
    try:
        recorded = json.loads(file.read_text())
        columns = {
            name: np.array([entry[name] for entry in recorded["entries"]], dtype=np.float64)
            for name in _COLUMNS
        }
        load = recorded["mass"], recorded["length"]
        is_on = all(entry["torque_enable"] for entry in recorded["entries"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise InvalidInput(f"{file} is no log of a servo: {error}") from error
    if load != (_MASS, _LENGTH):
        raise InvalidInput(
            f"{file} swings {load[0]} kg at {load[1]} m; expected are {_MASS} kg at {_LENGTH} m"
        )
    return Log(file.name, (Stream(columns),)) if is_on else None

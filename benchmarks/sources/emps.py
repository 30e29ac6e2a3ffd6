"""EMPS: a ball-screw positioning axis, measured at 1 kHz.

Janot, Gautier and Brunot, "Data set and reference models of EMPS", Workshop on Nonlinear System
Identification Benchmarks, 2019. Position [m] and controller output [V] of a prismatic joint under
position control; the force is the output times a known gain. Velocities are not measured: they
come from the position by a zero-phase low-pass and central differences, as in the paper, and all
is decimated to 100 Hz.
"""

from pathlib import Path

import numpy as np
from scipy import io, signal

from adr_service.arrays import Vector
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace

GAIN_N_PER_V = 35.15065188248547  # the file's `gtau`
_RATE_HZ, _CUTOFF_HZ, _DECIMATION = 1000, 100, 10
_ROWS = 100  # of an episode: one second
_QUANTUM_M = 5e-8
_XML = f"""
<mujoco model="emps">
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="carriage">
      <inertial pos="0 0 0" mass="90" diaginertia="1 1 1"/>
      <joint name="axis" type="slide" axis="1 0 0" solreffriction="0.004 1"/>
    </body>
  </worldbody>
  <actuator>
    <general name="drive" joint="axis" gear="{GAIN_N_PER_V}" biastype="affine"/>
  </actuator>
</mujoco>
"""


def nominal() -> Nominal:
    """An axis without friction: its mass and a constant force are free."""
    space = ParameterSpace(
        (
            Parameter("mass", "body:carriage.mass", "kg", 50.0, 150.0, 1.0),
            Parameter("offset", "actuator:drive.bias", "V", -1.0, 1.0, -10.0),
        )
    )
    return Nominal.of_model(_XML, space)


def read(path: Path) -> Measurement:
    """`DATA_EMPS.mat` or `DATA_EMPS_PULSES.mat`, cut into episodes of a second."""
    try:
        content = io.loadmat(path)
        position, output = (content[name].ravel() for name in ("qm", "vir"))
    except (OSError, ValueError, LookupError) as error:
        raise InvalidInput(f"{path} is no EMPS record: {error}") from error
    smooth = _low_pass(position)
    velocity = np.gradient(smooth, 1 / _RATE_HZ)
    count = (len(smooth) // _DECIMATION - 1) // _ROWS * _ROWS
    rows = np.arange(count) * _DECIMATION
    told = _low_pass(output)[: count * _DECIMATION].reshape(count, _DECIMATION).mean(axis=1)
    return Measurement(
        time=rows / _RATE_HZ,
        qpos=smooth[rows][:, None],
        qvel=velocity[rows][:, None],
        ctrl=told[:, None],
        episode=np.arange(count) // _ROWS,
        # velocities follow from positions: judging both would count the same error twice
        qpos_std=np.array([np.inf]),
        qvel_std=np.array([_QUANTUM_M * 2 * np.pi * _CUTOFF_HZ]),
    )


def _low_pass(values: Vector) -> Vector:
    sections = signal.butter(4, _CUTOFF_HZ / (_RATE_HZ / 2), output="sos")
    return signal.sosfiltfilt(sections, values)

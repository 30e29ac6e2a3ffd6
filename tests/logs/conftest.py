"""A robot of two joints, and logs of a motion that is known at every time."""

import mujoco
import numpy as np
import pytest

from adr_service.logs.base import Log, Stream
from adr_service.logs.mapping import LogMap

XML = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.03" mass="1"/>
      <body pos="0.5 0 0">
        <joint name="slider" type="slide" axis="1 0 0"/>
        <geom type="sphere" size="0.05" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="motor" joint="shoulder" gear="5" ctrlrange="-1 1" ctrllimited="true"/>
  </actuator>
</mujoco>
"""
MAP = """
[joints.shoulder]
position = "q1"
velocity = "dq1"
[joints.slider]
position = "q2"
velocity = "dq2"
[actuators.motor]
command = "u"
"""


@pytest.fixture(scope="session")
def robot():
    return mujoco.MjModel.from_xml_string(XML)


@pytest.fixture
def even():
    """20 s of a swinging shoulder and slider, read every 4 ms."""
    return motion(np.arange(0, 20, 0.004))


@pytest.fixture
def given():
    return LogMap.from_toml(MAP)


def motion(time):
    """Columns of a log at these times [s]."""
    return {
        "time": time,
        "q1": np.sin(3 * time),
        "dq1": 3 * np.cos(3 * time),
        "q2": 0.1 * np.cos(5 * time),
        "dq2": -0.5 * np.sin(5 * time),
        "u": np.sin(np.floor(time / 0.02 + 1e-6)),  # a new command every 20 ms
    }


def log(columns, source="log.csv"):
    return Log(source, (Stream(columns),))

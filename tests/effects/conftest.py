"""Small models with effects."""

import mujoco
import numpy as np
import pytest

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.simulator import Simulator
from adr_service.effects.models import make_inertias_explicit, with_effects
from adr_service.parameters import ParameterSpace

XML = """
<mujoco><default><general {default}/></default>
<worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
<geom name="box" size=".1" mass="2"/></body></worldbody>
<actuator><general name="push" joint="x" gear="3" dyntype="none"/></actuator></mujoco>
"""
PLAIN = XML.format(default="")


@pytest.fixture
def cart():
    """Builds a cart on a slide, without damping, with effects."""

    def build(*effects, xml=PLAIN):
        spec = mujoco.MjSpec.from_string(xml)
        make_inertias_explicit(spec)
        return with_effects(spec, lambda model: None, effects)

    return build


@pytest.fixture
def moving():
    """Builds simulators of a cart that starts at 1 m/s and at -1 m/s, with these defaults."""

    def build(default=""):
        rows = np.arange(120)
        data = Measurement(
            time=0.002 * rows,
            qpos=np.zeros((120, 1)),
            qvel=np.where(rows % 2, 1.0, -1.0)[:, None],
            ctrl=np.zeros((120, 1)),
            episode=rows // 12,
        )
        nominal = Nominal.of_model(XML.format(default=default), ParameterSpace(()))
        return Simulator(nominal, data, threads=1)

    return build

"""Effects in compiled models: units, places, and refusals."""

import mujoco
import numpy as np
import pytest

from adr_service.effects.base import Effect
from adr_service.effects.models import (
    check_simulated,
    element_of,
    make_inertias_explicit,
    unit_of,
)
from adr_service.errors import InvalidInput, UnknownName
from tests.hidden import arm


def test_a_slide_has_units_of_its_own(cart):
    model = cart()
    assert unit_of(model, "joint:x", "N m s/rad") == "N s/m"
    assert unit_of(model, "actuator:push", "N m") == "N"
    assert unit_of(model, "sensor:x.velocity", "of the sensor") == "m/s"
    assert unit_of(model, "body:cart", "kg") == "kg"


def test_a_hinge_has_the_units_of_the_catalogue():
    nominal = arm()[1]
    model = nominal.model(nominal.start)
    assert unit_of(model, "joint:elbow", "N m s/rad") == "N m s/rad"
    assert unit_of(model, "sensor:elbow.position", "of the sensor") == "rad"


def test_an_actuator_on_a_tendon_or_a_site_has_the_units_of_the_catalogue():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <worldbody>
            <body>
              <joint name="x" type="slide"/>
              <geom size="0.1"/>
              <site name="tip"/>
            </body>
          </worldbody>
          <tendon>
            <fixed name="first"><joint joint="x" coef="1"/></fixed>
            <fixed name="second"><joint joint="x" coef="1"/></fixed>
          </tendon>
          <actuator>
            <motor name="first" tendon="first"/>
            <motor name="second" tendon="second"/>
            <motor name="tip" site="tip"/>
          </actuator>
        </mujoco>
    """)
    units = [unit_of(model, f"actuator:{name}", "N m") for name in ("first", "second", "tip")]
    assert units == ["N m", "N m", "N m"]


def test_a_location_is_an_elements_number(cart):
    model = cart()
    assert element_of(model, "global") == 0
    assert element_of(model, "body:cart") == 1
    assert element_of(model, "sensor:x.velocity") == 1  # after all positions
    with pytest.raises(InvalidInput, match="the model has no 'joint:knee'"):
        element_of(model, "joint:knee")
    with pytest.raises(UnknownName, match=r"no sensor 'x.force'.*x.position, x.velocity"):
        element_of(model, "sensor:x.force")


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([Effect("joint_spring", "joint:x", (1.0,))] * 2, "is given twice; give it once"),
        ([Effect("sensor_bias", "sensor:x.position", (1.0,))], "acts on commands or in sensors"),
        ([Effect("joint_spring", "joint:y", (1.0,))], "no place of joint_spring 'joint:y'"),
        ([Effect("joint_spring", "joint:x", (1.0, 2.0))], "takes stiffness"),
        ([Effect("payload", "body:cart", (-1.0,))], "0 at least; given"),
        ([Effect("payload", "body:cart", (np.inf,))], "0 at least; given"),
    ],
)
def test_effects_that_cannot_be_simulated_are_refused(cart, effects, message):
    with pytest.raises(InvalidInput, match=message):
        check_simulated(cart(), effects)


def test_effects_at_one_place_add_up(cart):
    spring = [Effect("joint_spring", "joint:x", (k,)) for k in (1.0, 0.5)]
    assert cart(*spring).joint("x").stiffness[0] == 1.5


def test_explicit_inertias_leave_the_model_as_it_was():
    xml = arm()[1].xml
    spec = mujoco.MjSpec.from_string(xml)
    make_inertias_explicit(spec)
    explicit, plain = spec.compile(), mujoco.MjModel.from_xml_string(xml)
    np.testing.assert_allclose(explicit.body_mass, plain.body_mass, rtol=1e-12)
    np.testing.assert_allclose(explicit.body_inertia, plain.body_inertia, rtol=1e-9)


@pytest.mark.parametrize("static", ["false", "true"])
def test_least_masses_are_written_out_for_bodies_without_a_name(static):
    spec = mujoco.MjSpec.from_string(
        f"""<mujoco><compiler boundmass="0.01" boundinertia="0.001" fusestatic="{static}"/>
        <worldbody><body><joint/><geom size=".1" mass="1"/><body>
        <inertial pos="0 0 1" mass="0.001" diaginertia="1e-6 1e-6 1e-6"/></body></body></worldbody>
        </mujoco>"""
    )
    make_inertias_explicit(spec)
    assert spec.compiler.boundmass == 0
    assert [body.mass for body in spec.bodies[1:]] == [1.0, 0.01]

"""The simulator under criticism, and where its parameters start."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.nominal import Nominal
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.simulation.model import read, resolve
from adr_service.tasks.catalogue import get_task, source_of
from tests.hidden import arm


def test_a_start_outside_of_the_bounds_is_refused():
    space = ParameterSpace((Parameter("mass", "body:fore.mass", "kg", 2.0, 3.0, 2.0),))
    with pytest.raises(InvalidInput, match=r"the model has 0\.7 for mass, .* bounds: 2 to 3"):
        Nominal.of_model(get_task("arm").xml, space)


def test_a_model_starts_at_the_values_of_its_file():
    space = ParameterSpace((Parameter("mass", "body:fore.mass", "kg", 0.1, 3.0, 0.1),))
    nominal = Nominal.of_model(get_task("arm").xml, space)
    np.testing.assert_allclose(nominal.start, [0.7])


GANTRY = """
<mujoco>
  <worldbody>
    <body name="bridge">
      <joint name="x" type="slide" axis="1 0 0" damping="2"/>
      <geom size="0.1" mass="4"/>
      <body name="carriage">
        <joint name="y" type="slide" axis="0 1 0" damping="1"/>
        <geom size="0.1" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


def freed(*addresses, low=0.5):
    return ParameterSpace(tuple(Parameter(a, a, "", low, 5.0, low) for a in addresses))


@pytest.mark.parametrize(
    "twice",
    [("body:carriage.mass", "body:carriage.inertial"), ("joint:x.damping", "joint:*.damping")],
)
def test_an_element_that_two_parameters_set_is_refused(twice):
    with pytest.raises(InvalidInput, match="both set"):
        Nominal.of_model(GANTRY, freed(*twice))


def test_a_fixed_value_of_what_is_free_is_refused():
    with pytest.raises(InvalidInput, match=r"mass and body:bridge\.inertial both set"):
        Nominal.of_model(GANTRY, freed("body:bridge.inertial"), {"body:bridge.mass": 3.0})


def test_one_parameter_of_elements_that_differ_is_refused_and_of_equal_ones_is_not():
    with pytest.raises(InvalidInput, match=r"damping sets 2 values alike.* has 1 to 2 for them"):
        Nominal.of_model(GANTRY, freed("joint:*.damping"))
    alike = Nominal.of_model(GANTRY.replace('damping="2"', 'damping="1"'), freed("joint:*.damping"))
    assert alike.start.tolist() == [1.0]


@pytest.mark.parametrize(
    ("address", "low"),
    [
        ("body:carriage.mass", -1.0),
        ("body:carriage.inertial", -0.5),
        ("joint:x.damping", -0.1),
        ("joint:x.armature", -0.1),
    ],
)
def test_bounds_that_go_below_what_can_be_simulated_are_refused(address, low):
    with pytest.raises(InvalidInput, match=f"{address} is {low:g}; accepted are 0 and more"):
        Nominal.of_model(GANTRY, freed(address, low=low))


def test_masses_and_dampings_may_begin_at_zero_and_a_spring_below_it():
    Nominal.of_model(GANTRY, freed("body:carriage.mass", "joint:x.damping", low=0.0))
    Nominal.of_model(GANTRY, freed("joint:x.stiffness", low=-1.0))


def test_parameters_land_in_the_model():
    nominal = arm()[1]
    values = 1.1 * nominal.start
    model = nominal.model(values)
    for address, value in nominal.addressed(values).items():
        assert read(model, resolve(model, address)) == pytest.approx(value, rel=1e-12)


def test_a_source_that_is_extended_already_is_refused():
    payload = Effect("payload", "body:fore", (1.0,))
    source = replace(source_of("arm", "vanilla"), effects=(payload,))
    with pytest.raises(InvalidInput, match="arm is extended already"):
        Nominal.of_task(get_task("arm"), source)


def test_elements_without_a_name_get_one_so_that_effects_have_a_place():
    body = '<body><joint type="slide"/><geom size="1"/></body>'
    xml = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    model = Nominal.of_model(xml, ParameterSpace(())).model(np.empty(0))
    assert model.body(1).name == "unnamed_1"
    assert model.joint(0).name == "unnamed_0"


@pytest.mark.parametrize("taken", ["unnamed_0", "unnamed_1", "unnamed_2"])
def test_names_that_a_model_has_already_are_not_given_again(taken):
    """A file of ours has such names, and its user may add elements without any."""
    xml = f"""<mujoco><worldbody><geom size="1"/><body><joint/><geom size="1"/>
    <geom name="{taken}" size="1"/></body></worldbody></mujoco>"""
    model = Nominal.of_model(xml, ParameterSpace(())).model(np.empty(0))
    names = [model.geom(i).name for i in range(3)]
    assert taken in names
    assert len(set(names)) == 3
    assert all(names)

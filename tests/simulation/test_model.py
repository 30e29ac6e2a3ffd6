"""Addresses of parameters: they lead to the right elements, and wrong ones are explained."""

import mujoco
import numpy as np
import pytest

from adr_service.errors import InvalidInput, UnknownName
from adr_service.simulation.model import (
    FIELDS,
    action_names,
    addresses_of,
    compiled,
    differs,
    link_of,
    links_of,
    read,
    resolve,
    unit_at,
    write,
)
from adr_service.tasks.catalogue import get_task, source_of
from tests.tasks.cases import NAMES, TASKS

XML = """
<mujoco><worldbody>
<geom name="floor" type="plane" size="1 1 1"/>
<body name="slider"><joint name="slide" type="slide" damping="2" armature="3" stiffness="7"/>
<geom name="box" size=".1" mass="4"/>
<body name="ball" pos="0 0 1"><joint name="turn" type="ball"/><geom size=".1" mass="5"/></body>
</body></worldbody>
<contact><pair name="left" geom1="floor" geom2="box" friction="0.7 0.7"/></contact>
<actuator>
<general name="push" joint="slide" gear="6" biastype="affine" biasprm="8 0 0"/>
</actuator></mujoco>
"""
VALUES = {
    "body:slider.mass": 4.0,
    "body:slider.inertial": 4.0,
    "joint:slide.damping": 2.0,
    "joint:slide.armature": 3.0,
    "joint:slide.stiffness": 7.0,
    "actuator:push.gear": 6.0,
    "actuator:push.bias": 8.0,
    "pair:left.friction": 0.7,
}


@pytest.mark.parametrize("address", VALUES)
def test_an_address_reads_the_value_of_the_file_and_reads_back_what_was_written(address):
    model = mujoco.MjModel.from_xml_string(XML)
    slot = resolve(model, address)
    assert read(model, slot) == VALUES[address]
    write(model, slot, 9.5)
    assert read(model, slot) == 9.5


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("joint:turn.damping", "a free or a ball joint has several"),
        ("joint:turn.armature", "a free or a ball joint has several"),
        ("actuator:pull.bias", "the force of the actuator has no bias"),
    ],
)
def test_an_address_that_would_do_nothing_or_a_part_is_refused(address, why):
    pull = '<motor name="pull" joint="slide"/></actuator>'
    model = mujoco.MjModel.from_xml_string(XML.replace("</actuator>", pull))
    with pytest.raises(InvalidInput, match=f"{address} does nothing: {why}"):
        resolve(model, address)
    whole = address.replace("turn", "*").replace("pull", "*")
    able = address.replace("turn", "slide").replace("pull", "push")
    assert resolve(model, whole) == resolve(model, able)


@pytest.mark.parametrize("address", ["pair:*.friction", "actuator:*.gear"])
def test_all_of_what_a_model_lacks_is_refused(address):
    bare = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(InvalidInput, match=r"does nothing: the model has no (pair|actuator)"):
        resolve(bare, address)


def test_every_kind_of_address_is_tested():
    kinds = {tuple(address.replace(":", ".").split(".")[::2]) for address in VALUES}
    assert kinds == set(FIELDS)


@pytest.mark.parametrize(
    ("joints", "address", "unit"),
    [
        ('<joint name="a" type="slide"/>', "joint:a.damping", "N s/m"),
        ('<joint name="a" type="hinge"/>', "joint:a.armature", "kg m²"),
        ('<joint name="a"/><joint name="b" axis="1 0 0"/>', "joint:*.stiffness", "N m/rad"),
        (
            '<joint name="a"/><joint name="b" type="slide"/>',
            "joint:*.damping",
            "N m s/rad or N s/m",
        ),
        ('<joint name="a"/>', "body:link.mass", "kg"),
    ],
)
def test_an_address_has_a_unit_that_depends_on_the_joint(joints, address, unit):
    link = f'<body name="link">{joints}<geom size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{link}</worldbody></mujoco>")
    assert unit_at(model, address) == unit


def test_an_inertia_scales_with_its_mass_only_if_the_address_says_so():
    for attribute, factor in (("mass", 1.0), ("inertial", 2.5)):
        model = mujoco.MjModel.from_xml_string(XML)
        before = model.body("slider").inertia.copy()
        write(model, resolve(model, f"body:slider.{attribute}"), 10.0)
        np.testing.assert_allclose(model.body("slider").inertia, factor * before)


def test_a_star_names_all_of_a_kind_but_the_world():
    model = mujoco.MjModel.from_xml_string(XML)
    write(model, resolve(model, "body:*.mass"), 3.0)
    assert model.body_mass.tolist() == [0.0, 3.0, 3.0]


def test_a_star_names_elements_without_a_name_as_well():
    bare = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint damping="2"/><geom size=".1" mass="3"/></body>
        <body><joint damping="1"/><geom size=".1" mass="3"/></body></worldbody></mujoco>"""
    )
    for address, field in (("joint:*.damping", "dof_damping"), ("body:*.mass", "body_mass")):
        write(bare, resolve(bare, address), 7.0)
        assert getattr(bare, field)[-2:].tolist() == [7.0, 7.0]
    assert bare.body_mass[0] == 0


def test_what_has_no_inertia_is_left_alone():
    """A frame without mass: its inertia would be no number, and so would every simulation."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="arm"><joint/><geom size=".1" mass="3"/>
        <body name="flange"/></body></worldbody></mujoco>"""
    )
    write(model, resolve(model, "body:*.inertial"), 6.0)
    assert model.body_mass.tolist() == [0, 6, 0]
    assert np.isfinite(model.body_inertia).all()
    with pytest.raises(InvalidInput, match="a body without mass has no inertia to scale"):
        resolve(model, "body:flange.inertial")
    with pytest.raises(InvalidInput, match="the world does not move"):
        resolve(model, "body:world.mass")


def test_a_friction_holds_in_both_directions_of_a_pair():
    model = mujoco.MjModel.from_xml_string(XML)
    write(model, resolve(model, "pair:left.friction"), 0.4)
    assert model.pair_friction[0, :2].tolist() == [0.4, 0.4]


def test_names_of_elements_may_have_any_characters():
    body = "<body name='left-leg/shin.2'><geom size='1'/></body>"
    xml = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    slot = resolve(compiled(xml), "body:left-leg/shin.2.mass")
    assert (slot.field, slot.elements) == ("body_mass", ((1,),))


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("body:toso.mass", "did you mean 'torso'"),
        ("body:arm.mass", "accepted: torso, thigh"),  # and not the world, which has no mass
        ("body:torso.colour", "accepted: body:….mass"),
        ("torso mass", "kind:name.attribute"),
    ],
)
def test_an_address_that_leads_nowhere_is_explained(address, message):
    with pytest.raises((UnknownName, InvalidInput), match=message):
        resolve(compiled(get_task("hopper").xml), address)


@pytest.mark.parametrize("task", TASKS, ids=NAMES)
def test_the_addresses_of_a_source_are_its_fixed_values_and_its_parameters(task):
    unmodeled = source_of(task.name, "unmodeled")
    vanilla = source_of(task.name, "vanilla")
    assert set(addresses_of(unmodeled)) == set(addresses_of(vanilla))
    assert set(links_of(unmodeled)) == set(links_of(vanilla))
    assert bool(links_of(vanilla)) == (task.name == "walker2d")


def test_only_addresses_of_lengths_name_a_link():
    assert link_of("link:thigh.length") == "thigh"
    assert link_of("body:thigh.mass") is None
    assert link_of("link:thigh.width") is None


def test_models_differ_in_the_field_that_was_changed_and_in_no_option():
    one, other = (mujoco.MjModel.from_xml_string(XML) for _ in range(2))
    other.body_mass[1] += 1
    other.opt.timestep = 0.5
    assert differs(one, other, "body_mass")
    assert not differs(one, other, "body_inertia")
    assert not differs(one, other, "opt.timestep")


def test_a_model_is_compiled_once_and_a_broken_one_is_explained():
    assert compiled(XML) is compiled(XML)
    with pytest.raises(InvalidInput, match="MuJoCo cannot compile the model"):
        compiled("<mujoco><nothing/></mujoco>")


def test_actions_have_the_names_of_actuators_or_of_their_joints():
    xml = """<mujoco><worldbody><body><joint name="hinge"/><geom size=".1"/>
      <site name="tip"/></body></worldbody>
      <actuator><motor joint="hinge"/><motor name="push" joint="hinge"/>
      <general site="tip" gear="1 0 0 0 0 0"/></actuator></mujoco>"""
    assert action_names(xml) == ["hinge", "push", "actuator_2"]
    assert action_names(get_task("hopper").xml) == ["thigh", "leg", "foot"]

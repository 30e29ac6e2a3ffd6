"""The map from columns to a model."""

import mujoco
import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.logs.mapping import JointMap, LogMap
from tests.logs.conftest import MAP, XML


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "[joints.slider]",
            "[joints.slidr]",
            "no joint of the model 'slidr'; did you mean 'slider'",
        ),
        (
            '[joints.slider]\nposition = "q2"\nvelocity = "dq2"\n',
            "",
            r"lacks joints.*\[joints.slider.*that stays put can be deleted in the model",
        ),
        ("[actuators.motor]", "[actuators.engine]", "no actuator of the model 'engine'"),
        ('"q2"', '"q2"\nunit = "deg"', "slider: the joint is a slide, whose units are m, cm, mm"),
        ('"q1"', '"q1"\nunit = "mm"', "shoulder: the joint is a hinge, whose units are rad, deg"),
        ('"dq2"', '"dq2"\nvelocity_unit = "rpm"', "slider: the joint is a slide"),
        ('"q1"', '"q1"\nunit = "grad"', "joints.shoulder.unit: Input should be 'rad', 'deg'"),
        ('"q1"', '"q1"\noffset = 3', "there is no field 'offset'.* accepted: position, unit"),
        ('"dq1"', '"dq1"\nderive_velocity = true', "give either velocity or derive_velocity"),
        ('command = "u"', "scale = 2", "give either command, a column, or constant, a number"),
        ('command = "u"', "constant = 9\nscale = 2", "constant is in .* and goes without scale"),
        ("[joints.shoulder]", "[joints.shoulder", "the map is no TOML"),
        (
            "[joints.shoulder]",
            '[time]\nunit = "ms"\nnanoseconds = "n"\n[joints.shoulder]',
            "nanoseconds go with a column of unit 's'; given 'ms'",
        ),
        ('"q1"', '"q1"\nscale = 0', "joints.shoulder.scale: a scale of 0 makes all readings zero"),
        ('command = "u"', 'command = "u"\nscale = 0', "actuators.motor.scale: a scale of 0"),
        ('command = "u"', 'command = "u"\nunit = "deg"', "motor.unit is for a set-point that is a"),
        (
            'command = "u"',
            'command = "u"\nwrap = 6.3',
            r"motor.wrap is .*give joints.shoulder a wrap as well",
        ),
    ],
)
def test_a_wrong_map_is_refused_with_its_field(robot, old, new, message):
    assert old in MAP
    with pytest.raises(InvalidInput, match=message):
        LogMap.from_toml(MAP.replace(old, new)).check(robot)


def test_the_unit_of_a_set_point_is_of_its_joints_kind():
    """A hinge's set-points in millimetres became a thousandth of themselves."""
    servo = mujoco.MjModel.from_xml_string(XML.replace("<motor", "<position"))
    LogMap.from_toml(MAP.replace('command = "u"', 'command = "u"\nunit = "deg"')).check(servo)
    lengths = LogMap.from_toml(MAP.replace('command = "u"', 'command = "u"\nunit = "mm"'))
    with pytest.raises(InvalidInput, match=r"actuators.motor: the joint is a hinge, .* given 'mm'"):
        lengths.check(servo)


def test_a_set_point_of_a_joint_that_wraps_needs_a_wrap_as_well(robot):
    given = LogMap.from_toml(MAP.replace('"q1"', '"q1"\nwrap = 6.3'))
    given.check(robot)  # its motor has torques
    servo = XML.replace("<motor", "<position").replace('gear="5"', "")
    with pytest.raises(InvalidInput, match=r"readings of joints.shoulder wrap, so actuators.motor"):
        given.check(mujoco.MjModel.from_xml_string(servo))


def test_a_torque_has_no_turns(robot):
    """It was put next to its joint's angle."""
    wraps = MAP.replace('"q1"', '"q1"\nwrap = 6.3').replace('"u"', '"u"\nwrap = 6.3')
    with pytest.raises(InvalidInput, match=r"motor.wrap is .* no position of joints.shoulder"):
        LogMap.from_toml(wraps).check(robot)


@pytest.mark.parametrize(
    ("unit", "is_slide", "size"),
    [
        ("rad", False, 1.0),
        ("deg", False, np.pi / 180),
        ("rev", False, 2 * np.pi),
        ("m", True, 1.0),
        ("cm", True, 0.01),
        ("mm", True, 0.001),
    ],
)
def test_a_unit_has_its_size(unit, is_slide, size):
    speed = {"velocity": "dq", "velocity_unit": f"{unit}/s"}
    joint = JointMap.model_validate({"position": "q", "unit": unit, **speed})
    assert joint.position_factor(is_slide) == pytest.approx(size)
    assert joint.velocity_factor(is_slide) == pytest.approx(size)


def test_a_turn_per_minute_is_a_sixtieth_of_a_turn_per_second():
    joint = JointMap(position="q", velocity="dq", velocity_unit="rpm")
    assert joint.velocity_factor(is_slide=False) == pytest.approx(2 * np.pi / 60)

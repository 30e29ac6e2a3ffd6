"""The map from columns to a model."""

import mujoco
import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.logs.mapping import LogMap, draft
from tests.logs.conftest import MAP, log, motion


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
            r"lacks joints.*\[joints.slider",
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
    ],
)
def test_a_wrong_map_is_refused_with_its_field(robot, old, new, message):
    assert old in MAP
    with pytest.raises(InvalidInput, match=message):
        LogMap.from_toml(MAP.replace(old, new)).check(robot)


def test_a_draft_finds_columns_by_word_and_number(robot):
    columns = motion(np.arange(5.0))
    renamed = {"stamp_ms": columns["time"], "q1_deg": columns["q1"], "q2_mm": columns["q2"]}
    renamed |= {"dq1_deg": columns["dq1"], "current": columns["u"], "x": columns["u"]}
    text = draft([log(renamed)], robot)
    found = LogMap.from_toml(text)
    assert (found.time.column, found.time.unit) == ("stamp_ms", "ms")
    assert (found.joints["shoulder"].position, found.joints["shoulder"].unit) == ("q1_deg", "deg")
    assert (found.joints["slider"].position, found.joints["slider"].unit) == ("q2_mm", "mm")
    assert found.joints["slider"].velocity is None  # there are two joints and one column
    assert found.actuators["motor"].command == "current"
    assert "#   x: 5, " in text


def test_a_draft_finds_columns_by_the_joint_and_marks_what_it_does_not_know(robot):
    columns = {"/state.position.slider": np.zeros(3), "/state.position.wheel": np.zeros(3)}
    found = LogMap.from_toml(draft([log({"time": np.arange(3.0), **columns})], robot))
    assert found.joints["slider"].position == "/state.position.slider"
    assert found.actuators["motor"].command == "?"


def test_names_that_toml_cannot_bear_are_quoted():
    xml = """<mujoco><worldbody><body><joint name="left arm/1"/><geom size="1"/></body></worldbody>
    </mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    text = draft([log({"time": np.arange(3.0), "q": np.zeros(3)})], model)
    assert LogMap.from_toml(text).joints["left arm/1"].position == "q"

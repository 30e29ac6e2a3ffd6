"""Remarks on the data."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.criticism.linear import Persistence
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.noise import Noise
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.remarks import (
    on_commands,
    on_implausible,
    on_persistence,
    on_refuted,
    on_undetermined,
    on_untried,
)
from adr_service.effects.base import Effect
from adr_service.effects.models import plausible_of
from adr_service.parameters import ParameterSpace
from benchmarks.arms import links_of, model_of
from tests.hidden import arm


def test_constant_commands_and_commands_beyond_limits_have_a_remark(good):
    model = arm()[1].model(arm()[1].start)
    assert on_commands(model, Measurement(**good)) == ()
    commands = np.array(good["ctrl"])
    commands[:, 0], commands[:3, 1] = 0.25, -1.5
    still, beyond = on_commands(model, Measurement(**{**good, "ctrl": commands}))
    assert still.startswith("The command to actuator shoulder is 0.25 all the time")
    assert beyond.startswith("3 of 2250 commands to actuator elbow are beyond its limits, -1 to 1")
    rounded = np.array(good["ctrl"])
    rounded[0, 1] = np.nextafter(1.0, 2.0)
    assert on_commands(model, Measurement(**{**good, "ctrl": rounded})) == ()


def test_effects_that_may_be_nothing_have_a_remark():
    assert on_undetermined(()) == ()
    gone = [Effect("joint_spring", f"joint:{name}", (1.0,)) for name in ("elbow", "shoulder")]
    (remark,) = on_undetermined(gone)
    assert "joint_spring joint:elbow, joint_spring joint:shoulder" in remark
    assert "may all be zero" in remark


def test_parts_of_a_command_beyond_the_limits_count_though_its_mean_is_within(good):
    model = arm()[1].model(arm()[1].start)
    mean = 0.1 * np.sign(good["ctrl"])
    within = np.stack([mean + 1.4, mean - 1.4], axis=1)
    data = Measurement(**{**good, "ctrl": mean}, ctrl_within=within)
    shoulder, elbow = on_commands(model, data)
    assert shoulder.startswith("2250 of 2250 commands to actuator shoulder are beyond its limits")
    assert elbow.startswith("2250 of 2250 commands to actuator elbow")


def test_a_refuted_effect_is_named_with_its_place():
    remark = on_refuted([Effect("joint_spring", "joint:elbow", (0.5,))])
    assert "joint_spring joint:elbow" in remark


def test_misfit_that_persists_has_a_remark():
    noise = Noise(np.ones(2), np.ones((2, 2)), np.ones((1, 3)))
    assert on_persistence(Persistence(0.0, noise)) == ()
    (remark,) = on_persistence(Persistence(0.7, noise))
    assert "passes about 0.7 of itself on to the next one" in remark


TWO_JOINTS = """<mujoco><worldbody><body><joint name="one" {}/><geom size="1"/>
<body><joint name="two" {}/><geom size="1"/></body></body></worldbody></mujoco>"""
LIMITED = 'actuatorfrcrange="-1 1"'


@pytest.mark.parametrize(
    ("limits", "who", "where"),
    [
        ((LIMITED, ""), "joint one limits", "there"),
        ((LIMITED, LIMITED), "joints one, two limit", "at any joint"),
    ],
)
def test_effects_that_the_limits_of_joints_rule_out_have_a_remark(limits, who, where):
    model = mujoco.MjModel.from_xml_string(TWO_JOINTS.format(*limits))
    (remark,) = on_untried(model)
    assert remark.startswith(f"Not tried, because {who} the total force of actuators")
    assert f"joint_asymmetric_viscous_friction {where}, joint_stribeck_friction {where}" in remark
    assert remark.endswith("external_force at any body.")


def test_where_no_joint_limits_its_actuators_every_effect_is_tried():
    assert on_untried(mujoco.MjModel.from_xml_string(TWO_JOINTS.format("", ""))) == ()


def test_a_strength_that_no_robot_has_is_pointed_out():
    model = arm()[1].model(arm()[1].start)
    usual = Effect("joint_spring", "joint:elbow", (0.5,))
    (likely,) = plausible_of(model, usual)
    assert on_implausible(model, [usual]) == ()
    (remark,) = on_implausible(model, [usual, replace(usual, values=(-3 * likely,))])
    assert f"joint_spring joint:elbow needs a stiffness of {-3 * likely:.3g} N m/rad" in remark
    assert f"more than 2 times the {likely:.2g} N m/rad" in remark


def test_a_tool_of_several_times_the_last_links_mass_is_no_wrong_unit():
    model = Nominal.of_model(model_of(links_of(6)), ParameterSpace(())).model(np.empty(0))
    carried = Effect("body_load", "body:link6", (1.6, 0.08, 0.08, 0.24))
    assert on_implausible(model, [carried]) == ()
    (remark,) = on_implausible(model, [replace(carried, values=(10.0, 0.0, 0.0, 0.0))])
    assert "needs a mass of 10 kg" in remark

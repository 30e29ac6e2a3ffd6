"""Remarks on the data."""

from dataclasses import replace

import numpy as np

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.remarks import (
    on_commands,
    on_implausible,
    on_memory,
    on_refuted,
)
from adr_service.effects.base import Effect
from adr_service.effects.models import plausible_of
from tests.hidden import arm


def test_constant_commands_and_commands_beyond_limits_have_a_remark(good):
    model = arm()[1].model(arm()[1].start)
    assert on_commands(model, Measurement(**good)) == ()
    commands = np.array(good["ctrl"])
    commands[:, 0], commands[:3, 1] = 0.25, -1.5
    still, beyond = on_commands(model, Measurement(**{**good, "ctrl": commands}))
    assert still.startswith("The command to actuator shoulder is 0.25 all the time")
    assert beyond.startswith("3 of 2250 commands to actuator elbow are beyond its limits, -1 to 1")


def test_a_refuted_effect_is_named_with_its_place():
    remark = on_refuted([Effect("joint_spring", "joint:elbow", (0.5,))])
    assert "joint_spring joint:elbow" in remark


def test_a_misfit_with_memory_has_a_remark():
    assert on_memory(0.0) == ()
    assert "keeps about 0.7 of what was left" in on_memory(0.7)[0]


def test_a_strength_that_no_robot_has_is_pointed_out():
    model = arm()[1].model(arm()[1].start)
    usual = Effect("joint_spring", "joint:elbow", (0.5,))
    (likely,) = plausible_of(model, usual)
    assert on_implausible(model, [usual]) == ()
    (remark,) = on_implausible(model, [usual, replace(usual, values=(-3 * likely,))])
    assert f"joint_spring joint:elbow needs a stiffness of {-3 * likely:.3g} N m/rad" in remark
    assert f"more than 2 times the {likely:.2g} N m/rad" in remark

"""Frictions that depend on what a joint does, and the torques of drives that they depend on."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from adr_service.criticism.simulator import Simulator
from adr_service.effects.actuators import torque_of
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.friction import Losses, uses_torques, varies

DRIVES = {
    "motor": '<motor joint="x" gear="3"/>',
    "limited motor": '<motor joint="x" gear="3" ctrlrange="-.5 .7"/>',
    "servo": '<position joint="x" kp="20" kv="2" gear="2"/>',
    "weak servo": '<position joint="x" kp="20" kv="2" forcerange="-3 5"/>',
    "velocity servo": '<velocity joint="x" kv="4" gear="-2"/>',
    "variable gain": '<general joint="x" gaintype="affine" gainprm="1 2 3" biastype="affine" '
    'biasprm=".1 -.2 -.3"/>',
    "unused numbers": '<general joint="x" gainprm="2 5 7" biasprm="1 3 4"/>',
    "two": '<motor joint="x" gear="3"/><velocity joint="x" kv="1"/>',
}


def slide(drives, joint="", option=""):
    kind = "" if "type=" in joint else 'type="slide"'
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><option {option}/><worldbody><body><joint name="free"/><geom size=".1"/>
        <body><joint name="x" {kind} frictionloss=".5" {joint}/><geom size=".1"/></body>
        </body></worldbody><actuator>{drives}</actuator></mujoco>"""
    )


@pytest.mark.parametrize("joint", ["", 'actuatorfrcrange="-2 1"'])
@pytest.mark.parametrize("drives", DRIVES.values(), ids=DRIVES)
def test_torques_are_those_that_mujoco_exerts(drives, joint):
    model, rng = slide(drives, joint), np.random.default_rng(0)
    data, expected = mujoco.MjData(model), []
    qpos, qvel = rng.normal(size=(2, 40, 2))
    ctrl = rng.normal(size=(40, model.nu))
    for row in range(40):
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[row], qvel[row], ctrl[row]
        mujoco.mj_forward(model, data)
        expected.append(data.qfrc_actuator[1])
    found = torque_of(model, 1)(qpos[:, 1], qvel[:, 1], ctrl)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)


def test_a_joint_needs_drives_whose_force_is_known():
    load, motor = get_mechanism("joint_load_dependent_friction"), DRIVES["motor"]
    assert load.locations(slide(DRIVES["servo"])) == ["joint:x"]
    added = '<general name="adr_brake_x" joint="x"/>'
    assert load.locations(slide(motor + added)) == ["joint:x"]
    for unknown in (
        slide(""),
        slide(added),
        slide('<muscle joint="x" ctrlrange="0 1" lengthrange="0 1"/>'),
        slide('<general joint="x" dyntype="filter" dynprm=".1"/>'),
        slide(motor + '<general joint="x" dyntype="integrator"/>'),
        slide(motor, 'actuatorgravcomp="true"'),
        slide('<motor joint="x" group="3"/>', option='actuatorgroupdisable="3"'),
        slide(motor, option='><flag actuation="disable"/></option><option'),
        slide(motor.replace('"3"', '"3 0 0"'), 'type="ball"'),
    ):
        assert load.locations(unknown) == []


def test_friction_is_a_share_of_the_drives_torque_beside_the_models_own():
    effects = [Effect("joint_load_dependent_friction", "joint:x", (0.1,))]
    ctrl = np.array([[2.0], [-1.0], [0.0]])
    found = Losses(slide(DRIVES["motor"]), effects).at(*np.zeros((2, 3, 2)), ctrl)
    np.testing.assert_allclose(found, [[0, 0.5 + 0.6], [0, 0.5 + 0.3], [0, 0.5]], rtol=1e-12)
    assert varies(effects)
    assert not varies([Effect("joint_coulomb_friction", "joint:x", (0.1,))])


@pytest.mark.parametrize("mean", [0.1, -0.1])
def test_friction_by_position_repeats_in_a_turn_and_is_never_negative(mean):
    """It may be less than the model's own, and acts at a joint whatever moves it."""
    effects = [Effect("joint_position_dependent_friction", "joint:x", (mean, 0.3, 0.4, 3.0))]
    turns = np.linspace(0, 2 * np.pi, 200)
    qpos = np.column_stack([0 * turns, turns])
    model = slide('<muscle joint="x" ctrlrange="0 1" lengthrange="0 1"/>')
    found = Losses(model, effects).at(qpos, 0 * qpos, np.zeros((200, 1)))
    expected = 0.5 + mean + 0.3 * np.sin(3 * turns) + 0.4 * np.cos(3 * turns)
    assert (expected.min() < 0) == (mean < 0)
    np.testing.assert_allclose(found[:, 1], np.maximum(expected, 0), atol=1e-12)
    np.testing.assert_array_equal(found[:, 0], 0.0)
    assert not uses_torques(effects)


@pytest.mark.filterwarnings("error")
def test_what_has_diverged_warns_of_nothing():
    kinds = {"load_dependent": (0.1,), "position_dependent": (0.1, 0.3, 0.4, 3.0)}
    effects = [Effect(f"joint_{kind}_friction", "joint:x", v) for kind, v in kinds.items()]
    losses = Losses(slide(DRIVES["servo"]), effects)
    states = np.array([[0.0, np.inf], [0.0, np.nan], [0.0, 0.0]])
    found = losses.at(states, states, np.zeros((3, 1)))
    assert np.isfinite(found[2]).all()


def test_a_friction_that_happens_to_be_constant_is_coulombs_to_the_last_bit(moving):
    """The cart's drive pushes with 3 N for a command of one."""
    free = moving()
    pushed = replace(free.data, ctrl=np.full_like(free.data.ctrl, 0.7))
    with Simulator(free.nominal, pushed, threads=1) as slide:
        load, coulomb = (
            slide.predict(np.empty(0), [Effect(kind, "joint:x", (value,))], slide.measured)
            for kind, value in (
                ("joint_load_dependent_friction", 0.2),
                ("joint_coulomb_friction", 0.2 * (3 * 0.7)),
            )
        )
    np.testing.assert_array_equal(load, coulomb)
    assert not np.array_equal(load, free.predict(np.empty(0), [], free.measured))

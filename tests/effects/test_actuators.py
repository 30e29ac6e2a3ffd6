"""Effects on commands do what their formulas say."""

import mujoco
import numpy as np
import pytest

from adr_service.effects.actuators import drives, largest_force
from adr_service.effects.base import Commands, Effect
from adr_service.effects.catalogue import get_mechanism
from tests.effects.conftest import PLAIN

COMMANDS = Commands(np.array([[1.0, 1.0, -0.5, 0.2, 0.0, 0.8]]), 0.01, 1.0)


def obeyed(kind, strength):
    return get_mechanism(kind).command(COMMANDS, np.array([strength]))


def test_a_delay_of_whole_steps_shifts_commands_and_a_part_of_one_mixes_two():
    """The first command is taken to have held before: a servo stands where it was told to."""
    np.testing.assert_allclose(obeyed("actuator_delay", 0.02), [[1.0, 1.0, 1.0, 1.0, -0.5, 0.2]])
    np.testing.assert_allclose(
        obeyed("actuator_delay", 0.0025), [[1.0, 1.0, -0.125, 0.025, 0.05, 0.6]]
    )


def test_a_lag_is_the_mean_of_the_exact_first_order_response():
    seconds, constant = np.linspace(0, 0.01, 10_001), 0.03
    left = np.trapezoid(np.exp(-seconds / constant), seconds) / 0.01  # of a step, on average
    settled, _, stepped, *_ = obeyed("actuator_lag", constant)[0]
    assert settled == 1.0
    assert stepped == pytest.approx(-0.5 + 1.5 * left, rel=1e-6)


def test_a_lag_in_ten_times_finer_steps_is_the_same_on_average():
    """It remembers all commands before, and not the last alone."""
    lag, constant = get_mechanism("actuator_lag").command, np.array([0.03])
    fine = Commands(np.repeat(COMMANDS.values, 10, axis=1), 0.001, 1.0)
    average = lag(fine, constant).reshape(6, 10).mean(axis=1)
    np.testing.assert_allclose(average, lag(COMMANDS, constant)[0], rtol=1e-9)


def test_a_deadband_takes_its_width_from_every_command():
    np.testing.assert_allclose(obeyed("actuator_deadband", 0.3), [[0.7, 0.7, -0.2, 0.0, 0.0, 0.5]])


def test_a_saturation_cuts_the_largest_commands():
    np.testing.assert_allclose(
        obeyed("actuator_saturation", 0.4), [[0.6, 0.6, -0.5, 0.2, 0.0, 0.6]]
    )


def test_nothing_is_left_of_a_drive_that_has_lost_its_range():
    np.testing.assert_array_equal(obeyed("actuator_saturation", 1.2), np.zeros((1, 6)))


def test_gain_and_bias_are_of_drives_whose_force_is_in_proportion_to_the_command():
    """A DC motor's gain is its resistance and its constant at once."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="x"/><geom size="0.1" mass="1"/></body></worldbody>'
        '<actuator><motor name="torque" joint="x"/>'
        '<dcmotor name="dc" joint="x" motorconst="0.05" resistance="1"/></actuator></mujoco>'
    )
    for kind in ("actuator_gain", "actuator_bias"):
        assert get_mechanism(kind).locations(model) == ["actuator:torque"]


def test_deadband_and_fading_are_of_drives_whose_command_is_a_force():
    """A fading command would walk the goal of a servo to zero, which the drive still reaches."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="x"/><geom size="0.1" mass="1"/></body></worldbody>
        <actuator><motor name="motor" joint="x"/>
        <general name="offset" joint="x" biastype="affine" biasprm="2"/>
        <position name="position" joint="x" kp="20" kv="1"/>
        <velocity name="velocity" joint="x" kv="3"/></actuator></mujoco>"""
    )
    for kind in ("actuator_deadband", "actuator_fade"):
        assert get_mechanism(kind).locations(model) == ["actuator:motor", "actuator:offset"]


def test_a_fading_gain_is_whole_at_first_and_less_by_a_factor_in_every_step():
    expected = COMMANDS.values * 0.9 ** np.arange(6)
    np.testing.assert_allclose(obeyed("actuator_fade", -100 * np.log(0.9)), expected, rtol=1e-12)


def test_a_bias_is_a_force_after_the_gear(cart):
    model = cart(Effect("actuator_bias", "actuator:push", (1.5,)))
    assert model.actuator_biasprm[0, 0] * model.actuator_gear[0, 0] == pytest.approx(1.5)


def test_the_largest_force_of_an_unlimited_actuator_is_that_of_command_one(cart):
    model = cart()
    assert drives(model, 0) == [0]
    assert largest_force(model, 0) == 3.0  # its gear


def test_the_largest_force_is_within_the_bounds_of_the_drive_and_of_its_joint():
    """A position servo's gain times its largest command is far beyond what it can do."""

    def force(drive="", joint=""):
        model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><worldbody><body><joint name="j" {joint}/><geom size="1"/></body>
            </worldbody><actuator>
            <position joint="j" kp="500" ctrlrange="-3 3" gear="2" {drive}/></actuator>
            </mujoco>"""
        )
        return largest_force(model, 0)

    assert force() == 3000
    assert force('forcerange="-3 2"') == 6
    assert force('forcerange="-3 2"', 'actuatorfrcrange="-5 5"') == 5
    assert force(joint='actuatorfrcrange="-5 1"') == 5


def test_saturation_is_not_tried_where_no_command_is_cut(cart):
    model = cart()
    model.actuator_ctrllimited[:] = 1
    saturation = get_mechanism("actuator_saturation")
    assert saturation.locations(model) == ["actuator:push"]
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    assert saturation.locations(model) == []


def test_a_positive_gain_makes_a_drive_stronger_and_its_bias_too(cart):
    xml = PLAIN.replace('dyntype="none"', 'dyntype="none" biastype="affine" biasprm="0.2"')
    for effects, factor in (([], 1.0), ([Effect("actuator_gain", "actuator:push", (0.5,))], 1.5)):
        model = cart(*effects, xml=xml)
        data = mujoco.MjData(model)
        for command in (0.0, 1.0):
            data.ctrl[0] = command
            mujoco.mj_forward(model, data)
            assert data.qacc[0] == pytest.approx(factor * 3.0 * (command + 0.2) / 2.0)

"""Several effects on the way of one signal."""

import numpy as np
import pytest

from adr_service.effects.base import Effect
from adr_service.effects.signals import (
    behind,
    obeyed,
    offsets_of,
    rates_at_ends,
    recorded,
    shown,
    windows,
)
from adr_service.errors import InvalidInput

BIAS = Effect("sensor_bias", "sensor:x.position", (0.5,))
SCALE = Effect("sensor_scale", "sensor:x.position", (0.1,))
ENCODER = Effect("joint_encoder_scale", "joint:x", (0.1,))
STATES, RATES = np.array([[1.0, 2.0], [3.0, -1.0]]), np.zeros((2, 2))


def no_past(column):
    return np.empty((2, 0))


def test_effects_in_sensors_leave_other_columns_alone(cart):
    readings = shown(cart(), [BIAS, SCALE], STATES, RATES, no_past)
    np.testing.assert_allclose(readings[:, 0], [1.65, 3.85])  # first 0.5 more, then 1.1 times that
    np.testing.assert_array_equal(readings[:, 1], STATES[:, 1])


def test_an_encoders_scale_is_in_position_and_velocity(cart):
    readings = shown(cart(), [ENCODER], STATES, RATES, no_past)
    np.testing.assert_allclose(readings, 1.1 * STATES)
    np.testing.assert_allclose(recorded(cart(), [ENCODER], STATES[None], 0.1)[0], readings)


@pytest.mark.parametrize(
    "effects", [[BIAS], [SCALE], [ENCODER], [BIAS, SCALE], [SCALE, BIAS], [ENCODER, SCALE, BIAS]]
)
def test_effects_are_undone(cart, effects):
    readings = shown(cart(), effects, STATES, RATES, no_past)
    np.testing.assert_allclose(behind(cart(), effects, readings, RATES, no_past), STATES)


def test_readings_of_moments_are_those_of_a_record(cart):
    for effects in ([BIAS, SCALE], [SCALE, BIAS], [ENCODER, SCALE, BIAS]):
        readings = shown(cart(), effects, STATES, RATES, no_past)
        np.testing.assert_allclose(recorded(cart(), effects, STATES[None], 0.1)[0], readings)


def test_without_effects_signals_stay(cart):
    np.testing.assert_array_equal(shown(cart(), [], STATES, RATES, no_past), STATES)
    np.testing.assert_array_equal(behind(cart(), [], STATES, RATES, no_past), STATES)
    commands = np.ones((1, 3, 1))
    np.testing.assert_array_equal(obeyed(cart(), [], commands, 0.01), commands)


def test_effects_on_commands_act_in_their_order(cart):
    late = Effect("actuator_delay", "actuator:push", (0.01,))
    dead = Effect("actuator_deadband", "actuator:push", (0.5,))
    commands = np.array([1.0, 0.2, -1.0])[None, :, None]
    changed = obeyed(cart(), [late, dead], commands, 0.01)
    np.testing.assert_allclose(changed[0, :, 0], [0.5, 0.5, 0.0])


def test_records_pass_through_one_effect_after_the_other(cart):
    """First 0.5 more, then 1.1 times that."""
    readings = recorded(cart(), [BIAS, SCALE], STATES[None], 0.1)
    np.testing.assert_allclose(readings[0, :, 0], [1.65, 3.85])


def test_what_only_spreads_has_no_record(cart):
    noise = Effect("sensor_noise", "sensor:x.position", (0.1,))
    with pytest.raises(InvalidInput, match=r"sensor_noise .* or add noise"):
        recorded(cart(), [noise], STATES[None], 0.1)


def test_an_effect_in_the_model_is_no_effect_in_a_sensor(cart):
    with pytest.raises(InvalidInput, match="joint_spring is not in a sensor"):
        offsets_of(cart(), Effect("joint_spring", "joint:x", (1.0,)), STATES, RATES, no_past)


def test_an_effect_that_uses_the_past_is_given_that_of_its_column(cart):
    """The first row came 3 m forwards, the second 2 m backwards; half of the gap is .2 m."""
    pasts = {0: np.array([[1.0, 3.0], [-2.0, -2.0]])}
    backlash = Effect("joint_backlash", "joint:x", (0.4,))
    readings = shown(cart(), [backlash], STATES, RATES, pasts.__getitem__)
    np.testing.assert_allclose(readings, STATES + np.array([[-0.2, 0], [0.2, 0]]))
    true = behind(cart(), [backlash], readings, RATES, pasts.__getitem__)
    np.testing.assert_allclose(true, STATES)


def test_rates_are_needed_for_late_velocities_alone(cart):
    late = [
        Effect("sensor_delay", f"sensor:x.{each}", (0.01,)) for each in ("position", "velocity")
    ]
    assert windows(cart(), [BIAS, SCALE, late[0]]) == {}
    assert windows(cart(), [BIAS, *late]) == {1: 0.01}


@pytest.mark.parametrize(
    ("window", "then"), [(0.0, 6.0), (0.1, 6.0), (0.15, 4.5), (0.2, 3.0), (0.3, 0.0), (9.0, 0.0)]
)
def test_a_rate_is_over_a_window_of_a_step_at_least_and_the_path_at_most(window, then):
    """Between two moments on a line, as records are late."""
    path = np.array([0.0, 3.0, 6.0, 10.0])
    (rates,) = rates_at_ends(np.column_stack([path, path])[None], 0.1, {1: window})
    np.testing.assert_allclose(rates, [40.0, (10.0 - then) / min(max(window, 0.1), 0.3)])

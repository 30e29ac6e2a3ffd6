"""Effects in sensors: readings by hand, and approximations against exact records."""

import numpy as np
import pytest

from adr_service.effects.base import Effect, Motion
from adr_service.effects.catalogue import MECHANISMS

TRUTH = np.array([[0.0, 1.0, 3.0, 3.0]])
PERIOD, NO_PAST = 0.5, np.empty((4, 0))


@pytest.mark.parametrize(
    ("kind", "strength", "expected"),
    [
        ("sensor_bias", 0.1, [[0.1, 1.1, 3.1, 3.1]]),
        ("sensor_scale", 0.1, [[0.0, 1.1, 3.3, 3.3]]),
        ("sensor_delay", 0.25, [[0.0, 0.5, 2.0, 3.0]]),
        ("sensor_delay", 0.75, [[0.0, 0.0, 0.5, 2.0]]),  # a step and a half
    ],
)
def test_readings_are_those_that_a_reader_computes_by_hand(kind, strength, expected):
    record = MECHANISMS[kind].sensing.record
    np.testing.assert_allclose(record(TRUTH, np.array([strength]), PERIOD), expected)


@pytest.mark.parametrize("kind", ["sensor_bias", "sensor_scale", "sensor_delay"])
def test_an_offset_is_the_difference_between_record_and_truth(kind):
    sensing, values = MECHANISMS[kind].sensing, np.array([0.1])
    rates = np.diff(TRUTH[0], prepend=0.0) / PERIOD
    states, no_rates = np.column_stack([TRUTH[0], rates]), np.full((4, 2), np.nan)
    motion = Motion(states, no_rates, column=0, past=NO_PAST)
    expected = (sensing.record(TRUTH, values, PERIOD) - TRUTH)[0]
    np.testing.assert_allclose(sensing.offset(motion, values), expected, atol=1e-15)


def test_a_velocity_is_late_by_how_fast_it_changes():
    rates = np.column_stack([np.full(4, np.nan), [1.0, 2.0, 4.0, 0.0]])
    motion = Motion(np.zeros((4, 2)), rates, column=1, past=NO_PAST)
    offset = MECHANISMS["sensor_delay"].sensing.offset(motion, np.array([0.1]))
    np.testing.assert_allclose(offset, [-0.1, -0.2, -0.4, 0.0])


def test_steps_and_noise_move_nothing_on_average():
    motion = Motion(TRUTH.T, np.zeros((4, 1)), column=0, past=NO_PAST)
    for kind in ("sensor_quantisation", "sensor_noise"):
        assert MECHANISMS[kind].only_spreads
        assert not MECHANISMS[kind].sensing.offset(motion, np.array([1.0])).any()


def test_a_sensor_with_a_scale_shows_what_a_robot_without_it_does(moving):
    slide = moving()
    effect = Effect("sensor_scale", "sensor:x.velocity", (0.2,))
    predicted = slide.predict(np.empty(0), [effect], slide.measured * [1.0, 1.2])
    expected = slide.predict(np.empty(0), [], slide.measured)
    np.testing.assert_allclose(predicted[:, 0], expected[:, 0], atol=1e-12)
    np.testing.assert_allclose(predicted[:, 1], 1.2 * expected[:, 1], atol=1e-12)

"""First-order responses, against simulations with the effect."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.fits import fit
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.responses import Responses
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from tests.hidden import arm


@pytest.fixture(scope="module")
def baseline(good):
    data = Measurement(**good).episodes(range(8))
    with Simulator(arm()[1], data, threads=1) as simulator:
        yield fit(simulator, data.sensor_variance())


@pytest.fixture(scope="module")
def responses(baseline):
    return Responses(baseline)


@pytest.mark.parametrize(
    "effect",
    [
        Effect("joint_spring", "joint:elbow", (0.01,)),
        Effect("actuator_deadband", "actuator:elbow", (0.01,)),
        Effect("actuator_delay", "actuator:elbow", (1e-4,)),
        Effect("actuator_lag", "actuator:shoulder", (1e-4,)),
        Effect("sensor_bias", "sensor:elbow.position", (1e-4,)),
        Effect("sensor_scale", "sensor:elbow.velocity", (1e-4,)),
        Effect("joint_encoder_scale", "joint:elbow", (1e-4,)),
        Effect("sensor_delay", "sensor:shoulder.position", (1e-5,)),
        Effect("sensor_delay", "sensor:elbow.velocity", (1e-5,)),
    ],
)
def test_a_response_is_the_change_that_a_simulation_shows(baseline, responses, effect):
    simulator, known = baseline.simulator, (baseline.parameters, baseline.states)
    without, with_it = (
        simulator.predict_quickly(known[0], effects, known[1]) for effects in ((), (effect,))
    )
    expected = baseline.layout.fold(with_it - without)
    error = np.abs(responses.of(effect)[..., 0] - expected).max()
    assert error < 0.05 * np.abs(expected).max()


def test_a_response_to_a_ripple_is_what_its_sine_and_its_cosine_change(baseline, responses):
    """At most a fifth of a wave passes in one control step of this recording."""
    ripple = Effect("joint_torque_ripple", "joint:elbow", (0.01, 0.02, 5.0))
    simulator, known = baseline.simulator, (baseline.parameters, baseline.states)
    without, with_sine, with_both = (
        baseline.layout.fold(simulator.predict_quickly(known[0], effects, known[1]))
        for effects in ((), (replace(ripple, values=(0.01, 0.0, 5.0)),), (ripple,))
    )
    expected = np.stack([with_sine - without, with_both - with_sine, 0 * without], axis=-1)
    error = np.sum((responses.of(ripple) - expected) ** 2, axis=(0, 1, 2))
    assert np.all(error <= 0.05**2 * np.sum(expected**2, axis=(0, 1, 2)))


def test_a_response_to_friction_by_position_is_coulombs_where_the_joint_is(baseline, responses):
    friction = Effect("joint_position_dependent_friction", "joint:elbow", (0.02, 0.01, 0.005, 5.0))
    simulator, known = baseline.simulator, (baseline.parameters, baseline.states)
    without, with_it = (
        baseline.layout.fold(simulator.predict_quickly(known[0], effects, known[1]))
        for effects in ((), (friction,))
    )
    expected, found = with_it - without, responses.of(friction)
    assert not found[..., 3].any()  # waves in a turn are no amount
    error = np.sum((found.sum(axis=-1) - expected) ** 2, axis=(0, 1))
    assert np.all(error <= 0.05**2 * np.sum(expected**2, axis=(0, 1)))


def test_strengths_of_one_effect_add_up_to_the_whole(baseline, responses):
    tilt = Effect("gravity_tilt", "global", (0.01, 0.01))
    response = responses.of(tilt)
    assert response.shape[-1] == 2
    simulator = baseline.simulator
    without, with_it = (
        simulator.predict_quickly(baseline.parameters, effects, baseline.states)
        for effects in ((), (tilt,))
    )
    np.testing.assert_allclose(
        response.sum(axis=-1), baseline.layout.fold(with_it - without), atol=1e-12
    )


def test_the_columns_of_a_fit_are_parameters_integration_and_strengths(baseline):
    count = len(baseline.parameters)
    assert baseline.integration == slice(count, count + 2)
    assert baseline.linear.columns.shape[3] == count + 2
    assert baseline.held_out.shape == (8,)

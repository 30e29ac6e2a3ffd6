"""Residuals and their derivatives, against differences of predictions."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.layout import Layout
from adr_service.criticism.linearisation import (
    INTEGRATION,
    by_strengths,
    linearise,
    root_of,
    spread,
    tiny_root,
)
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from tests.hidden import arm

SPRING = Effect("joint_spring", "joint:elbow", (0.5,))


@pytest.fixture(scope="module")
def simulator(good):
    data = Measurement(**good).episodes(range(6))
    with Simulator(arm()[1], data, threads=1) as simulator:
        yield simulator


def linearised(simulator, states, effects=()):
    root = np.broadcast_to(tiny_root(simulator), (len(states), 4, 4))
    start = simulator.nominal.start
    return linearise(simulator, Layout.of(simulator), start, effects, states, root)[0]


def by_strengths_of(simulator, effects, by):
    """Derivatives by strengths, at the measured states and the model's own parameters."""
    known = (simulator.nominal.start, effects, simulator.measured)
    return by_strengths(simulator, *known, by, simulator.predict_quickly(*known))


@pytest.fixture(scope="module")
def linear(simulator):
    return linearised(simulator, simulator.measured, (SPRING,))


def close(actual, expected):
    return np.abs(actual - expected).max() < 1e-3 * np.abs(expected).max()


def test_columns_are_parameters_then_integration_then_strengths(linear, simulator):
    count = len(simulator.nominal.start)
    assert linear.columns.shape[3] == count + INTEGRATION + 1
    known = np.flatnonzero(linear.precision)
    np.testing.assert_array_equal(known, np.arange(count, count + INTEGRATION))
    assert not linear.mean[np.delete(np.arange(count + INTEGRATION + 1), known)].any()


def test_residuals_around_measured_states_are_errors_of_predictions(linear, simulator):
    predicted = simulator.predict(simulator.nominal.start, (SPRING,), simulator.measured)
    expected = simulator.measured[simulator.starts + 1] - predicted
    np.testing.assert_allclose(linear.residual[linear.chain.mask], expected, atol=1e-6)


@pytest.mark.parametrize("number", range(4))
def test_derivatives_by_a_parameter_are_differences_of_predictions(linear, simulator, number):
    below, above = (simulator.nominal.start.copy() for _ in range(2))
    below[number] -= 1e-3
    above[number] += 1e-3
    low, high = (
        simulator.predict_quickly(values, (SPRING,), simulator.measured)
        for values in (below, above)
    )
    assert close(linear.columns[linear.chain.mask][..., number], (high - low) / 2e-3)


def test_derivatives_by_states_are_differences_of_predictions(linear, simulator):
    start, states = simulator.nominal.start, simulator.measured
    for column, step in enumerate(1e-3 * np.eye(4)):
        low, high = (
            simulator.predict_quickly(start, (SPRING,), states + way) for way in (-step, step)
        )
        slope = linear.chain.transition[linear.chain.mask][..., column]
        assert close(slope, (high - low) / 2e-3)


def test_derivatives_by_strengths_are_differences_of_predictions(simulator):
    start, states = simulator.nominal.start, simulator.measured
    (derivative,) = by_strengths_of(simulator, (SPRING,), (SPRING,))
    below, above = (
        simulator.predict_quickly(start, (replace(SPRING, values=(k,)),), states)
        for k in (0.49, 0.51)
    )
    assert close(derivative, (above - below) / 0.02)


def test_a_strength_that_cannot_be_negative_is_moved_to_one_side(simulator):
    start, states = simulator.nominal.start, simulator.measured
    none = Effect("joint_coulomb_friction", "joint:elbow", (0.0,))
    (derivative,) = by_strengths_of(simulator, (none,), (none,))
    plain = simulator.predict_quickly(start, (), states)
    some = simulator.predict_quickly(start, (replace(none, values=(1e-3,)),), states)
    assert np.all(np.isfinite(derivative))
    assert np.sum(derivative * (some - plain)) > 0


def test_no_effects_have_no_derivatives(simulator):
    assert by_strengths_of(simulator, (SPRING,), ()) == []


def test_only_the_transition_that_diverges_is_masked(simulator):
    states = simulator.measured.copy()
    states[3] = 1e12  # beyond what MuJoCo simulates
    layout, linear = Layout.of(simulator), linearised(simulator, states)
    missing = np.argwhere(layout.mask & ~linear.chain.mask)
    np.testing.assert_array_equal(missing, [[0, 3]])
    for values in (linear.residual, linear.columns, linear.chain.transition):
        assert np.all(np.isfinite(values))
        assert not values[0, 3].any()


def test_a_simulation_that_mostly_diverges_is_refused_with_its_counts(simulator):
    states = simulator.measured.copy()
    states[:300] = 1e12  # four of six episodes of 75 transitions
    with pytest.raises(InvalidInput, match="diverges from 297 of 450 measured states"):
        linearised(simulator, states)


def test_a_root_of_a_covariance_gives_it_back():
    rng = np.random.default_rng(0)
    factors = rng.standard_normal((5, 3, 3))
    covariance = factors @ factors.swapaxes(1, 2)
    root = root_of(covariance, 1e-6 * np.eye(3))
    np.testing.assert_allclose(root @ root.swapaxes(1, 2), covariance, rtol=1e-5, atol=1e-5)
    assert np.all(np.isfinite(root_of(np.zeros((2, 3, 3)), 1e-6 * np.eye(3))))


def test_the_tiny_root_is_in_proportion_to_the_spread_of_each_state(simulator):
    deviations = np.diag(tiny_root(simulator))
    assert np.ptp(deviations / spread(simulator)) < 1e-12
    assert np.all(deviations < 1e-3 * simulator.measured.std(axis=0))

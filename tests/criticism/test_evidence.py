"""Fits of a simulator to a measurement, their linearisation, and what they are worth."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.decision import is_evidence
from adr_service.criticism.evidence import expected_errors, fit, refine, settled, smoothed
from adr_service.criticism.flexible_force import flexible_gains
from adr_service.criticism.gain import measure_gain
from adr_service.criticism.linearisation import by_strengths, root_of
from adr_service.criticism.naming import Weighed, slots
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from benchmarks.planted import draw_case, hide
from tests.hidden import arm

FRICTION = Effect("joint_coulomb_friction", "joint:elbow", (0.1,))


@pytest.fixture(scope="module")
def hidden():
    """A measurement of an arm with friction at the elbow."""
    return hide(*arm(), np.random.default_rng(404), [FRICTION])


@pytest.fixture(scope="module")
def baseline(hidden):
    """A fit without the friction, to the first twelve episodes."""
    data = hidden.episodes(range(12))
    sensor = data.sensor_variance()
    with Simulator(arm()[1], data, threads=1, finer=3) as simulator:
        yield smoothed(fit(simulator, sensor), sensor)


@pytest.fixture(scope="module")
def refined(baseline):
    start = replace(FRICTION, values=(0.05,))
    return refine(baseline, [start], baseline.simulator.data.sensor_variance())


def test_parameters_that_start_off_the_truth_are_recovered():
    case = draw_case(*arm(), np.random.default_rng(200), 0.3, count=0)
    data = case.measurement.episodes(range(12))
    sensor = data.sensor_variance()
    with Simulator(case.nominal, data, threads=1, finer=3) as simulator:
        parameters = smoothed(fit(simulator, sensor), sensor).parameters
    np.testing.assert_allclose(parameters, case.truth, rtol=0.02)


def test_a_missing_effect_is_recovered_from_half_of_its_strength(refined):
    assert refined.effects[0].values[0] == pytest.approx(0.1, rel=0.1)


def test_a_missing_effect_gains_evidence_on_left_out_episodes(baseline, refined):
    without = settled(baseline, baseline.simulator.data.sensor_variance()).held_out
    assert is_evidence(refined.held_out - without)


def test_the_noise_of_sensors_is_estimated(refined):
    """Planted: 1 mrad and 10 mrad/s."""
    np.testing.assert_allclose(np.sqrt(refined.noise.sensor), [1e-3, 1e-3, 1e-2, 1e-2], rtol=0.2)
    assert np.all(expected_errors(refined) > np.sqrt(refined.noise.sensor))


def test_an_effect_without_mass_left_explains_nothing(baseline):
    gone = Effect("body_mass", "body:fore", (-5.0,))
    assert refine(baseline, [gone], baseline.simulator.data.sensor_variance()) is None


def test_columns_of_strengths_follow_those_of_integration(refined):
    columns = refined.columns_of(slice(0, 1))
    assert (columns.start, columns.stop) == (refined.integration.stop, refined.integration.stop + 1)
    assert refined.linear.columns.shape[3] == columns.stop


def test_derivatives_by_strengths_are_differences_of_predictions(baseline):
    simulator, states = baseline.simulator, baseline.states
    spring = Effect("joint_spring", "joint:elbow", (0.5,))
    (derivative,) = by_strengths(simulator, baseline.parameters, (spring,), states)
    below, above = (
        simulator.predict_quickly(baseline.parameters, (replace(spring, values=(k,)),), states)
        for k in (0.49, 0.51)
    )
    expected = (above - below) / 0.02
    assert np.abs(derivative - expected).max() < 1e-3 * np.abs(expected).max()


def test_a_fit_gains_nothing_over_itself(baseline, hidden):
    sealed = hidden.episodes(range(12, 16))
    gain = measure_gain(baseline, baseline, sealed, np.random.default_rng(0), threads=1)
    assert (gain.sse_removed, gain.low, gain.high) == (0.0, 0.0, 0.0)
    assert all(before == after for before, after in gain.horizons.values())


def test_the_true_effect_gains_on_sealed_episodes(baseline, refined, hidden):
    sealed = hidden.episodes(range(12, 20))
    gain = measure_gain(baseline, refined, sealed, np.random.default_rng(0), threads=1)
    assert gain.low > 0
    assert gain.explainable_fraction > 0.5


def test_a_flexible_force_adds_nothing_to_the_true_effect(baseline, refined):
    sensor = baseline.simulator.data.sensor_variance()
    assert not is_evidence(flexible_gains(settled(refined, sensor), sensor))


def test_effects_of_a_fit_belong_to_those_that_were_named(refined):
    single = Weighed((FRICTION,), refined, refined.held_out, 1.0)
    pair = Weighed((FRICTION, FRICTION), refined, refined.held_out, 1.0)
    assert slots([(pair, single), (single,)]) == [slice(0, 2), slice(2, 3)]
    assert single.newest == refined.effects
    assert pair.fair_gain < single.fair_gain == single.gain


def test_a_folded_state_comes_back_by_row(baseline):
    simulator, layout = baseline.simulator, baseline.layout
    folded = layout.fold(simulator.measured[simulator.starts])
    first = simulator.measured[simulator.starts[0]]
    np.testing.assert_array_equal(folded[0, 0], first)
    states = np.concatenate([folded, np.zeros((len(folded), 1, folded.shape[2]))], axis=1)
    rows = layout.by_row(simulator, states)
    np.testing.assert_array_equal(rows[simulator.starts], simulator.measured[simulator.starts])


def test_a_root_of_a_covariance_gives_it_back():
    rng = np.random.default_rng(0)
    factors = rng.standard_normal((5, 3, 3))
    covariance = factors @ factors.swapaxes(1, 2)
    root = root_of(covariance, 1e-6 * np.eye(3))
    np.testing.assert_allclose(root @ root.swapaxes(1, 2), covariance, rtol=1e-5, atol=1e-5)
    assert np.all(np.isfinite(root_of(np.zeros((2, 3, 3)), 1e-6 * np.eye(3))))

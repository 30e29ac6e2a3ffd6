"""Variances and weights, against what was drawn."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.linear import estimate
from adr_service.criticism.noise import Noise, Whitener
from adr_service.criticism.variances import Ascent, at_start, lifted
from tests.chains import MISFIT, SENSOR, WIDTH, drawn, interrupted, remembered, unexplained

UNKNOWN = np.full(WIDTH, np.nan)


def estimated(chain, residual, sensor):
    """The noise of residuals that nothing explains."""
    linear, start = unexplained(chain, residual), at_start(chain, residual, sensor)
    return estimate(linear, start, known=np.isfinite(sensor))[0]


def bound(chain, residual, noise):
    whitener = Whitener.of(chain, noise)
    return whitener.log_likelihood(whitener.whiten(residual[..., None])[..., 0]).sum()


def test_variances_of_sensors_and_of_stiff_misfit_are_recovered_and_regimes_told_apart():
    """Within 15 %: with 590 transitions a variance has a relative error of about 6 % (2/n)."""
    chain, residual, _ = drawn(SENSOR, MISFIT, np.random.default_rng(1))
    heavy = estimated(chain, residual, UNKNOWN)
    np.testing.assert_allclose(heavy.sensor, SENSOR, rtol=0.15)
    # the t distribution of the misfit has a smaller scale where what was drawn is Gaussian
    np.testing.assert_allclose(heavy.misfit[1], MISFIT[1], rtol=0.5)
    assert np.all(heavy.misfit[0] < 0.2 * heavy.misfit[1])  # drawn: a fiftieth


def test_known_variances_of_sensors_stay():
    chain, residual, _ = drawn(SENSOR, MISFIT, np.random.default_rng(2))
    found = estimated(chain, residual, SENSOR)
    np.testing.assert_array_equal(found.sensor, SENSOR)


def test_a_transition_that_fits_nothing_loses_its_weight():
    chain, residual, _ = drawn(SENSOR, MISFIT, np.random.default_rng(3))
    residual = residual.copy()
    residual[5, 7] += 100.0
    found = estimated(chain, residual, UNKNOWN)
    assert found.weights[5, 7] < 0.05
    assert np.median(found.weights) > 0.5


@pytest.mark.parametrize("share", [0.0, 0.6])
def test_the_bound_rises_as_its_gradient_says_and_with_new_weights(share):
    rng = np.random.default_rng(5)
    chain, residual = interrupted(*drawn(SENSOR, MISFIT, rng)[:2])
    chain, residual = remembered(chain, residual, share)
    weights = np.where(chain.mask, rng.uniform(0.3, 2.0, chain.mask.shape), 1.0)
    noise = Noise(2 * SENSOR, 0.5 * MISFIT, weights)
    ascent = Ascent.of(Whitener.of(chain, noise), residual)
    for row, column in np.ndindex(3, WIDTH):
        moved = []
        for step in (1e-4, -1e-4):
            factor = np.ones((3, WIDTH))
            factor[row, column] = np.exp(step)
            changed = Noise(noise.sensor * factor[0], noise.misfit * factor[1:], weights)
            moved.append(bound(chain, residual, changed))
        slope = (moved[0] - moved[1]) / 2e-4
        assert ascent.gradient[row, column] == pytest.approx(slope, rel=1e-5, abs=1e-6)
    heavier = replace(noise, weights=ascent.weights)
    assert bound(chain, residual, heavier) > bound(chain, residual, noise)


def test_weights_settle_where_the_bound_is_highest():
    chain, residual, _ = drawn(SENSOR, MISFIT, np.random.default_rng(7))
    noise = Noise(SENSOR, MISFIT, np.ones(chain.mask.shape))
    for _ in range(100):
        noise = replace(noise, weights=Ascent.of(Whitener.of(chain, noise), residual).weights)
    highest = bound(chain, residual, noise)
    for factor in (0.9, 1.1):
        weights = noise.weights.copy()
        weights[4, 5:10] *= factor
        assert bound(chain, residual, replace(noise, weights=weights)) < highest


def test_variances_come_back_from_next_to_nothing():
    """From a sensor's variance of 1e-14, where the gradient by its logarithm is none."""
    chain, residual, _ = drawn(SENSOR, MISFIT, np.random.default_rng(6))
    known = np.zeros(WIDTH, dtype=bool)
    collapsed = Noise(SENSOR * np.array([1e-14, 1.0]), 10 * MISFIT, np.ones(chain.mask.shape))
    linear = unexplained(chain, residual)
    found = estimate(linear, lifted(collapsed, chain, residual, known), known)[0]
    np.testing.assert_allclose(found.sensor, SENSOR, rtol=0.15)

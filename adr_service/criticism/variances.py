"""Maximum-likelihood variances of a measured trajectory's noise, and where their search starts.

By the average information algorithm (Gilmour, Thompson and Cullis, 1995); the weights of the t
distribution as in robust Kalman smoothing (Agamennoni, Nieto and Nebot, 2012).
"""

from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Array3, Mask, Matrix, Vector
from adr_service.criticism.noise import (
    DEGREES,
    Chain,
    Noise,
    Whitener,
    columnwise,
    misfit_variance,
    score_covariance,
    score_of,
)

_LEAST = 1e-12  # variance that rounding leaves, relative to the residuals'
_LIFTED = 1e-3  # least variance at the start, relative to that of typical residuals
_HIDDEN = 1e-3  # least variance of the misfit, relative to the sensor's
_ROUGHLY = 1e-6  # floor on the information of a variance, which may not be identifiable
_FURTHEST = 3.0  # largest step of the logarithm of a variance


@dataclass(frozen=True)
class Ascent:
    """Gradient and curvature of the log-likelihood of residuals, about a noise."""

    noise: Noise
    gradient: Matrix  # (3, m) by the logarithms of the sensor's, the free and the stiff variance
    information: Matrix  # (3 m, 3 m) "average information" of the same
    weights: Matrix  # (E, T) the most likely ones
    regimes: tuple[Mask, Mask]  # (E, T) free, stiff
    floor: Vector  # (m,) of all variances that are estimated
    measured: Mask  # (m,)

    @classmethod
    def of(cls, whitener: Whitener, residual: Array3) -> "Ascent":
        """About the whitener's noise; `residual` (E, T, m)."""
        chain, noise = whitener.chain, whitener.noise
        mask, m = chain.mask, residual.shape[2]
        adjoint = whitener.adjoint(whitener.whiten(residual[..., None])[..., 0])
        blocks = whitener.inverse_blocks()
        expected = np.diagonal(blocks[0], axis1=2, axis2=3)
        score = score_of(chain, adjoint)
        covariance = score_covariance(chain, *blocks, columnwise)
        spread, own = misfit_variance(chain, noise), np.arange(m)
        regimes = (mask & ~chain.stiff, mask & chain.stiff)
        gradient, moved = np.empty((3, m)), np.zeros((*adjoint.shape, 3 * m))
        gradient[0] = noise.sensor * np.sum(score**2 - covariance, axis=(0, 1)) / 2
        error = noise.sensor * score
        moved[..., own, own] = error[:, 1:] * mask[..., None]
        moved[..., :m] -= chain.transition * error[:, :-1, None, :]
        if chain.memory is not None:
            moved[:, 1:, :, :m] += chain.memory.earlier[:, 1:] * error[:, :-2, None, :]
        for number, where in enumerate(regimes, 1):
            variance = where[..., None] * spread
            gradient[number] = np.sum(variance * (adjoint**2 - expected), axis=(0, 1)) / 2
            moved[..., own, number * m + own] = variance * adjoint
        rows = whitener.whiten(moved).reshape(-1, 3 * m)
        moment = spread + spread**2 * (adjoint**2 - expected)  # E[w²] given the residuals
        energy = np.sum(moment / (spread * noise.weights[..., None]), axis=2)
        weights = np.where(mask, (DEGREES + m) / (DEGREES + energy), 1.0)
        floor = np.maximum(_LEAST * np.mean(residual[mask] ** 2, axis=0), chain.exact)
        bend = rows.T @ rows / 2
        return cls(noise, gradient, bend, weights, regimes, floor, chain.measured)

    def step(self, known: Mask, damping: float) -> Noise:
        """Noise after a damped Newton step of the variances and an EM update of the weights.

        `known` (m,): sensors whose variances stay. If all weights of a regime change by a factor,
        its variances do as well (PX-EM; Liu, Rubin and Wu, 1998).
        """
        noise, m = self.noise, len(known)
        free = np.concatenate([~known, *(np.full(m, where.any()) for where in self.regimes)])
        bend = self.information[np.ix_(free, free)]
        bend = bend + np.diag(damping * np.diag(bend) + _ROUGHLY)
        change = np.zeros(3 * m)
        change[free] = np.linalg.solve(bend, self.gradient.ravel()[free])
        factor = np.exp(np.clip(change, -_FURTHEST, _FURTHEST)).reshape(3, m)
        sensor, misfit = noise.sensor * factor[0], noise.misfit * factor[1:]
        for number, where in enumerate(self.regimes):
            if where.any():
                lighter = np.log(self.weights[where] / noise.weights[where]).mean()
                misfit[number] *= np.exp(lighter)
        sensor = np.where(known, noise.sensor, np.maximum(sensor, self.floor))
        least = _least_misfit(sensor, self.floor, self.measured)
        return Noise(sensor, np.maximum(misfit, least), self.weights)


def lifted(noise: Noise, chain: Chain, residual: Array3, known: Mask) -> Noise:
    """Noise without variances so close to zero that no step would leave it.

    `known` (m,): sensors whose variances stay.
    """
    least = _LIFTED * _typical_variance(chain, residual)
    sensor = np.where(known, noise.sensor, np.maximum(noise.sensor, least))
    misfit = np.maximum(noise.misfit, _least_misfit(sensor, least, chain.measured))
    return replace(noise, sensor=sensor, misfit=misfit)


def at_start(chain: Chain, residual: Array3, sensor: Vector) -> Noise:
    """A first guess: half of the residuals' robust variance for each sensor, a tenth for misfit.

    `sensor` (m,): known variances, NaN for unknown ones.
    """
    variance = _typical_variance(chain, residual)
    given = np.where(np.isnan(sensor), variance / 2, np.maximum(sensor, 1e-24))
    return Noise(given, np.tile(variance / 10, (2, 1)), np.ones(chain.mask.shape))


def _least_misfit(sensor: Vector, floor: Vector, measured: Mask) -> Vector:
    """Least variances (m,) of misfit: hidden by the sensors, but enough to weigh outliers."""
    return np.maximum(floor, np.where(measured, _HIDDEN * sensor, 0.0))


def _typical_variance(chain: Chain, residual: Array3) -> Vector:
    """(m,) robust variance of the residuals."""
    spread = 1.4826 * np.median(np.abs(residual[chain.mask]), axis=0)
    return np.maximum(spread**2, chain.exact)

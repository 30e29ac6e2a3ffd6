"""Noise that a measured trajectory carries, and what of it explains the one-step residuals.

Around smoothed states, the residuals of an episode are linear in everything that is unknown:

    r_k = e_{k+1} - F_k e_k + w_k + (what parameters and causes would add)

with sensor noise e ~ N(0, R) and misfit w ~ Student-t(0, Q). Q has two values: one for transitions
in which a contact or a limit acts, where small errors of the state have large consequences, and
one for all others. Consecutive residuals share a sensor's noise; whitening an episode as a whole,
by the Cholesky factor of its block-tridiagonal covariance, is what a Kalman filter does, and gives
independent numbers of variance one. Variances are found by maximum likelihood (MM updates; Zhou,
Hu, Zhou and Lange, "MM algorithms for variance components models", 2019); the weights of the
t distribution as in robust Kalman smoothing (Agamennoni, Nieto and Nebot, 2012).

Arrays are (E episodes, T transitions, ...), padded; `mask` says which there are.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from adr_service.arrays import Array3, Mask, Matrix, Vector

DEGREES = 4.0  # of freedom of the misfit's t distribution
_ROUNDING = 1e-11  # relative, so that covariances stay positive
_LEAST = 1e-12  # relative to the residuals' variance: what rounding leaves


@dataclass(frozen=True)
class Chain:
    """How noise passes through the transitions of all episodes."""

    mask: Mask  # (E, T)
    transition: np.ndarray  # (E, T, m, m) F, zero where there is none
    stiff: Mask  # (E, T) whether a contact or a limit acts


@dataclass(frozen=True)
class Noise:
    """Variances of a measurement, in the columns' units squared."""

    sensor: Vector  # (m,) R
    misfit: Matrix  # (2, m) Q, of free and of stiff transitions
    weights: Matrix  # (E, T) of the t distribution; small: an outlier


@dataclass(frozen=True)
class Whitener:
    """Makes residuals of whole episodes independent, with variance one."""

    chain: Chain
    noise: Noise
    inverse: np.ndarray  # (E, T, m, m) of the factor's diagonal blocks
    below: np.ndarray  # (E, T, m, m) the factor's blocks left of the diagonal
    log_determinant: Vector  # (E,) of the covariance

    @classmethod
    def of(cls, chain: Chain, noise: Noise) -> "Whitener":
        mask, transition = chain.mask, chain.transition
        episodes, count, m = transition.shape[:3]
        diagonal = (transition * noise.sensor) @ transition.swapaxes(2, 3)
        diagonal += np.diag(noise.sensor)
        own = np.arange(m)
        diagonal[..., own, own] += _spread(chain, noise)
        diagonal[..., own, own] *= 1 + _ROUNDING
        diagonal[~mask] = np.eye(m)
        left = -transition * noise.sensor  # covariance with the transition before
        left[:, 0] = 0.0
        left[:, 1:][~mask[:, :-1]] = 0.0
        inverse, below = np.empty_like(diagonal), np.zeros_like(diagonal)
        log_determinant = np.zeros(episodes)
        for k in range(count):
            block = diagonal[:, k]
            if k > 0:
                below[:, k] = left[:, k] @ inverse[:, k - 1].swapaxes(1, 2)
                block = block - below[:, k] @ below[:, k].swapaxes(1, 2)
            factor = np.linalg.cholesky(block)
            inverse[:, k] = np.linalg.inv(factor)
            log_determinant += 2 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return cls(chain, noise, inverse, below, log_determinant)

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """(E, T, m, c) residuals or sensitivities, made independent."""
        white = np.empty_like(columns)
        for k in range(columns.shape[1]):
            rest = columns[:, k]
            if k > 0:
                rest = rest - self.below[:, k] @ white[:, k - 1]
            white[:, k] = self.inverse[:, k] @ rest
        return white

    def adjoint(self, white: Array3) -> Array3:
        """The inverse covariance times residuals (E, T, m), from their whitened form."""
        found = np.empty_like(white)
        for k in reversed(range(white.shape[1])):
            rest = white[:, k]
            if k + 1 < white.shape[1]:
                rest = rest - np.einsum("eij,ei->ej", self.below[:, k + 1], found[:, k + 1])
            found[:, k] = np.einsum("eij,ei->ej", self.inverse[:, k], rest)
        return found

    def inverse_blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Diagonal blocks (E, T, m, m) of the inverse covariance, and those left of them."""
        diagonal, left = np.zeros_like(self.inverse), np.zeros_like(self.inverse)
        last = self.inverse.shape[1] - 1
        for k in reversed(range(last + 1)):
            own = self.inverse[:, k]
            middle = np.eye(own.shape[1])
            if k < last:
                below = self.below[:, k + 1]
                left[:, k + 1] = -diagonal[:, k + 1] @ below @ own
                middle = middle + below.swapaxes(1, 2) @ diagonal[:, k + 1] @ below
            diagonal[:, k] = own.swapaxes(1, 2) @ middle @ own
        return diagonal, left

    def log_likelihood(self, white: Array3) -> Vector:
        """(E,) of whitened residuals, the weights' own probability included."""
        mask, weights = self.chain.mask, self.noise.weights
        count = mask.sum(axis=1) * white.shape[2]
        square = np.sum(white**2, axis=(1, 2))
        shape = DEGREES / 2
        prior = shape * np.log(shape) - gammaln(shape)
        prior = prior + (shape - 1) * np.log(weights) - shape * weights
        normal = -0.5 * (square + self.log_determinant + count * np.log(2 * np.pi))
        return normal + np.sum(prior * mask, axis=1)

    def sensor_errors(self, residual: Array3) -> tuple[Array3, np.ndarray]:
        """What sensors probably added to each state (E, T + 1, m), and that guess's covariance."""
        adjoint = self.adjoint(self.whiten(residual[..., None])[..., 0])
        blame, chance = _by_state(self.chain, adjoint, *self.inverse_blocks())
        sensor = self.noise.sensor
        return blame * sensor, np.diag(sensor) - sensor[:, None] * chance * sensor


def updated(whitener: Whitener, residual: Array3, known: Mask) -> Noise:
    """Noise after one MM update of the variances and one EM update of the weights.

    `residual` (E, T, m); `known` (m,): whose sensors' variances stay as they are.
    """
    chain, noise = whitener.chain, whitener.noise
    mask = chain.mask
    floor = _LEAST * np.maximum(np.mean(residual[mask] ** 2, axis=0), 1e-30)
    adjoint = whitener.adjoint(whitener.whiten(residual[..., None])[..., 0])
    diagonal, left = whitener.inverse_blocks()
    information = np.diagonal(diagonal, axis1=2, axis2=3)
    misfit = noise.misfit.copy()
    for regime, where in enumerate((mask & ~chain.stiff, mask & chain.stiff)):
        scale = 1 / noise.weights[where][:, None]
        misfit[regime] *= _ratio(scale * adjoint[where] ** 2, scale * information[where])
    blame, chance = _by_state(chain, adjoint, diagonal, left)
    factor = _ratio(_rows(blame) ** 2, _rows(np.diagonal(chance, axis1=2, axis2=3)))
    sensor = np.where(known, noise.sensor, noise.sensor * factor)
    spread = _spread(chain, noise)
    moment = spread + spread**2 * (adjoint**2 - information)  # E[w²] given the residuals
    energy = np.sum(moment / (spread * noise.weights[..., None]), axis=2)
    weights = np.where(mask, (DEGREES + residual.shape[2]) / (DEGREES + energy), 1.0)
    return Noise(np.maximum(sensor, floor), np.maximum(misfit, floor), weights)


def at_start(chain: Chain, residual: Array3, sensor: Vector) -> Noise:
    """A first guess: half of the residuals' robust variance is either sensor's, a tenth misfit.

    `sensor` (m,) holds the variances that are known, and NaN.
    """
    spread = 1.4826 * np.median(np.abs(residual[chain.mask]), axis=0)
    variance = np.maximum(spread**2, 1e-24)
    given = np.where(np.isnan(sensor), variance / 2, np.maximum(sensor, 1e-24))
    return Noise(given, np.tile(variance / 10, (2, 1)), np.ones(chain.mask.shape))


def _spread(chain: Chain, noise: Noise) -> Array3:
    """(E, T, m) variances of each transition's misfit."""
    return noise.misfit[chain.stiff.astype(int)] / noise.weights[..., None]


def _ratio(seen: Matrix, expected: Matrix) -> Vector:
    """The MM update's factor (m,) of a variance, from rows (n, m)."""
    if not len(seen):
        return np.ones(seen.shape[1])
    return np.sqrt(seen.sum(axis=0) / np.maximum(expected.sum(axis=0), 1e-300))


def _rows(values: Array3) -> Matrix:
    return values.reshape(-1, values.shape[2])


def _by_state(
    chain: Chain, adjoint: Array3, diagonal: np.ndarray, left: np.ndarray
) -> tuple[Array3, np.ndarray]:
    """Score of each state's sensor noise (E, T + 1, m), and the score's covariance.

    A state's noise stands in the residual that ends there and, through F, in the next one.
    """
    e, t, m = adjoint.shape
    transition, shown = chain.transition, chain.mask[..., None]
    score, chance = np.zeros((e, t + 1, m)), np.zeros((e, t + 1, m, m))
    score[:, 1:] += adjoint * shown
    score[:, :-1] -= (transition.swapaxes(2, 3) @ adjoint[..., None])[..., 0]
    back = transition.swapaxes(2, 3)
    chance[:, 1:] += diagonal * shown[..., None]
    chance[:, :-1] += back @ diagonal @ transition
    cross = back[:, 1:] @ left[:, 1:]
    chance[:, 1:-1] -= cross + cross.swapaxes(2, 3)
    return score, chance

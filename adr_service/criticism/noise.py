"""Noise of a measured trajectory, and the share of the one-step residuals that it explains.

Around smoothed states, the residuals of an episode are linear in everything that is unknown:

    r_k = e_{k+1} - F_k e_k + w_k + (what parameters and causes would add)

with sensor noise e ~ N(0, R) and misfit w ~ Student-t(0, Q). Q has two values: one for transitions
in which a contact or a limit acts, where small errors of the state have large consequences, and
one for all others. Consecutive residuals share a sensor's noise; whitening an episode as a whole,
by the Cholesky factor of its block-tridiagonal covariance, is what a Kalman filter does, and gives
independent numbers of variance one. `variances` estimates R, Q and the weights of the t
distribution.

Misfit that is correlated in time, w_k = rho w_{k-1} + u_k, becomes independent in what is new,
r_k - rho r_{k-1} (`Chain.remembering`), which shares sensors' noise with two transitions before.

Arrays are (E episodes, T transitions, ...), padded; `mask` says which there are.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from adr_service.arrays import Array3, Mask, Matrix, Vector

DEGREES = 4.0  # of freedom of the misfit's t distribution
_ROUNDING = 1e-11  # relative, so that covariances stay positive
_KEPT, _LARGEST_KEPT = 4, 1_000_000  # factors of a chain; numbers in each of their arrays


@dataclass(frozen=True)
class Memory:
    """A misfit that is correlated in time: w_k = share w_{k-1} + u_k."""

    share: float  # 0 to 1
    linked: Mask  # (E, T) whether a transition's misfit remembers that of the one before
    earlier: np.ndarray  # (E, T, m, m) G, through which noise passes of the state before

    def innovations(self, values: np.ndarray) -> np.ndarray:
        """Residuals or sensitivities (E, T, ...) less what the transition before passes on.

        Of a residual, e_{k+1} - F_k e_k + G_k e_{k-1} + u_k is left, with the chain's own F.
        """
        linked = self.linked.reshape(*self.linked.shape, *[1] * (values.ndim - 2))
        return values - self.share * np.where(linked, np.roll(values, 1, axis=1), 0.0)


@dataclass(frozen=True)
class Chain:
    """Sensitivities through which noise passes in the transitions of all episodes."""

    mask: Mask  # (E, T)
    transition: np.ndarray  # (E, T, m, m) F, zero where there is none
    stiff: Mask  # (E, T) whether a contact or a limit acts
    measured: Mask  # (m,) true for sensors that have readings
    exact: Vector  # (m,) variance below which residuals are errors of computing them
    memory: Memory | None = None  # None: each transition's misfit is its own

    @cached_property
    def factors(self) -> "dict[bytes, Factor]":
        """Factors of its covariance, by `Noise.key`, the latest last."""
        return {}

    def where(self, mask: Mask) -> "Chain":
        """The chain with these transitions alone."""
        assert self.memory is None
        return replace(
            self, mask=mask, transition=np.where(mask[..., None, None], self.transition, 0.0)
        )

    def remembering(self, share: float) -> "Chain":
        """The chain of `Memory.innovations`, where misfit keeps a share of the one before.

        That of a contact or a limit is over with its transition.
        """
        assert self.memory is None
        linked = self.mask & ~self.stiff
        linked[:, 1:] &= linked[:, :-1].copy()
        linked[:, 0] = False
        kept = share * linked[..., None, None]
        earlier = kept * np.roll(self.transition, 1, axis=1)
        moved = self.transition + kept * np.eye(self.transition.shape[2])
        return replace(self, transition=moved, memory=Memory(share, linked, earlier))

    def of_episodes(self, which: slice) -> "Chain":
        """The chain of some of the episodes."""
        memory = self.memory
        return Chain(
            self.mask[which],
            self.transition[which],
            self.stiff[which],
            self.measured,
            self.exact,
            memory and replace(memory, linked=memory.linked[which], earlier=memory.earlier[which]),
        )


@dataclass(frozen=True)
class Noise:
    """Variances of a measurement, in the columns' units squared."""

    sensor: Vector  # (m,) R
    misfit: Matrix  # (2, m) Q, of free and of stiff transitions
    weights: Matrix  # (E, T) of the t distribution; small: an outlier

    @property
    def key(self) -> bytes:
        """Equal for equal noises of one chain."""
        return b"".join(part.tobytes() for part in (self.sensor, self.misfit, self.weights))


@dataclass(frozen=True)
class Factor:
    """The Cholesky factor of a chain's covariance under a noise, by blocks."""

    inverse: np.ndarray  # (E, T, m, m) of the factor's diagonal blocks
    below: np.ndarray  # (E, T, m, m) the factor's blocks left of the diagonal
    further: np.ndarray | None  # (E, T, m, m) and left of those; None without memory
    log_determinant: Vector  # (E,) of the covariance

    @classmethod
    def of(cls, chain: Chain, noise: Noise) -> "Factor":
        diagonal, left, further = _covariances(chain, noise)
        inverse, below = np.empty_like(diagonal), np.zeros_like(diagonal)
        log_determinant = np.zeros(len(diagonal))
        for k in range(diagonal.shape[1]):
            block = diagonal[:, k]
            if further is not None and k > 1:
                further[:, k] = further[:, k] @ inverse[:, k - 2].swapaxes(1, 2)
                left[:, k] -= further[:, k] @ below[:, k - 1].swapaxes(1, 2)
                block = block - further[:, k] @ further[:, k].swapaxes(1, 2)
            if k > 0:
                below[:, k] = left[:, k] @ inverse[:, k - 1].swapaxes(1, 2)
                block = block - below[:, k] @ below[:, k].swapaxes(1, 2)
            factor = np.linalg.cholesky(block)
            inverse[:, k] = np.linalg.inv(factor)
            log_determinant += 2 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return cls(inverse, below, further, log_determinant)

    def of_episodes(self, which: slice) -> "Factor":
        """The same for some of the episodes."""
        further = None if self.further is None else self.further[which]
        return Factor(self.inverse[which], self.below[which], further, self.log_determinant[which])


@dataclass(frozen=True)
class Whitener:
    """Makes residuals of whole episodes independent, with variance one."""

    chain: Chain
    noise: Noise
    factor: Factor

    @classmethod
    def of(cls, chain: Chain, noise: Noise) -> "Whitener":
        """Takes the factor that `keep` has stored for an equal noise, if there is one."""
        return cls(chain, noise, chain.factors.get(noise.key) or Factor.of(chain, noise))

    def keep(self) -> None:
        """Let the chain have its factor for the next whitener of an equal noise."""
        if self.factor.inverse.size <= _LARGEST_KEPT:
            known = self.chain.factors
            known.pop(self.noise.key, None)
            known[self.noise.key] = self.factor  # the latest is the last
            while len(known) > _KEPT:
                del known[next(iter(known))]

    def of_episodes(self, which: slice) -> "Whitener":
        """The same for some of the episodes."""
        return Whitener(
            self.chain.of_episodes(which),
            replace(self.noise, weights=self.noise.weights[which]),
            self.factor.of_episodes(which),
        )

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """(E, T, m, c) residuals or sensitivities, made independent."""
        white = np.empty_like(columns)
        for k in range(columns.shape[1]):
            rest = columns[:, k]
            if k > 0:
                rest = rest - self.factor.below[:, k] @ white[:, k - 1]
            if self.factor.further is not None and k > 1:
                rest = rest - self.factor.further[:, k] @ white[:, k - 2]
            white[:, k] = self.factor.inverse[:, k] @ rest
        return white

    def adjoint(self, white: Array3) -> Array3:
        """The inverse covariance times residuals (E, T, m), from their whitened form."""
        whole = np.empty_like(white)
        for k in reversed(range(white.shape[1])):
            rest = white[:, k]
            if k + 1 < white.shape[1]:
                rest = rest - np.einsum("eij,ei->ej", self.factor.below[:, k + 1], whole[:, k + 1])
            if self.factor.further is not None and k + 2 < white.shape[1]:
                rest = rest - np.einsum(
                    "eij,ei->ej", self.factor.further[:, k + 2], whole[:, k + 2]
                )
            whole[:, k] = np.einsum("eij,ei->ej", self.factor.inverse[:, k], rest)
        return whole

    def inverse_blocks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Diagonal blocks (E, T, m, m) of the inverse covariance, those left of them and, with
        memory, those left of these (Takahashi's recursion)."""
        diagonal, left = np.zeros_like(self.factor.inverse), np.zeros_like(self.factor.inverse)
        outer = None if self.factor.further is None else np.zeros_like(self.factor.inverse)
        last = self.factor.inverse.shape[1] - 1
        for k in reversed(range(last + 1)):
            own = self.factor.inverse[:, k]
            middle = np.eye(own.shape[1])
            if k < last:
                below = self.factor.below[:, k + 1]
                left[:, k + 1] = -diagonal[:, k + 1] @ below @ own
                middle = middle + below.swapaxes(1, 2) @ diagonal[:, k + 1] @ below
            if outer is not None and self.factor.further is not None and k + 1 < last:
                below, further = self.factor.below[:, k + 1], self.factor.further[:, k + 2]
                near = left[:, k + 2].swapaxes(1, 2) @ further
                far = left[:, k + 2] @ below + diagonal[:, k + 2] @ further
                left[:, k + 1] -= near @ own
                outer[:, k + 2] = -far @ own
                middle = middle + below.swapaxes(1, 2) @ near + further.swapaxes(1, 2) @ far
                middle = (middle + middle.swapaxes(1, 2)) / 2  # else rounding grows
            diagonal[:, k] = own.swapaxes(1, 2) @ middle @ own
        return diagonal, left, outer

    def log_likelihood(self, white: Array3) -> Vector:
        """(E,) of whitened residuals: a lower bound that posterior weights make tight, up to what
        depends on their number alone (variational Bayes; Tipping and Lawrence, 2005)."""
        mask, weights = self.chain.mask, self.noise.weights
        count = mask.sum(axis=1) * white.shape[2]
        square = np.sum(white**2, axis=(1, 2))
        prior = DEGREES / 2 * (np.log(weights) - weights)
        normal = -0.5 * (square + self.factor.log_determinant + count * np.log(2 * np.pi))
        return normal + np.sum(prior * mask, axis=1)

    def sensor_errors(self, residual: Array3) -> tuple[Array3, np.ndarray]:
        """Estimates of the sensors' errors in each state (E, T + 1, m), and their covariance."""
        adjoint = self.adjoint(self.whiten(residual[..., None])[..., 0])
        score = score_of(self.chain, adjoint)
        covariance = score_covariance(self.chain, *self.inverse_blocks(), _matrices)
        sensor = self.noise.sensor
        return score * sensor, np.diag(sensor) - sensor[:, None] * covariance * sensor


def _covariances(chain: Chain, noise: Noise) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Covariances (E, T, m, m) of each transition's residual with itself, with that of the
    transition before and, with memory, with that before it."""
    transition, memory, sensor = chain.transition, chain.memory, noise.sensor
    diagonal = (transition * sensor) @ transition.swapaxes(2, 3)
    diagonal += np.diag(sensor)
    left, further = -transition * sensor, None
    if memory is not None:
        known = memory.earlier * sensor
        diagonal += known @ memory.earlier.swapaxes(2, 3)
        left[:, 1:] -= known[:, 1:] @ transition[:, :-1].swapaxes(2, 3)
        further = np.where(np.roll(chain.mask, 2, axis=1)[..., None, None], known, 0.0)
    own = np.arange(len(sensor))
    diagonal[..., own, own] += misfit_variance(chain, noise)
    diagonal[..., own, own] *= 1 + _ROUNDING
    diagonal[~chain.mask] = np.eye(len(sensor))
    left[:, 0] = 0.0
    left[:, 1:][~chain.mask[:, :-1]] = 0.0
    return diagonal, left, further


def misfit_variance(chain: Chain, noise: Noise) -> Array3:
    """(E, T, m) variances of each transition's misfit; with memory, of what is new in it."""
    variance = noise.misfit[chain.stiff.astype(int)] / noise.weights[..., None]
    if chain.memory is None:
        return variance
    share, linked = chain.memory.share, chain.memory.linked
    return variance / np.where(linked, 1.0, 1 - share**2)[..., None]


def score_of(chain: Chain, adjoint: Array3) -> Array3:
    """Score of each state's sensor noise (E, T + 1, m).

    A state's noise stands in the residual that ends there and, through F, in the next one.
    """
    e, t, m = adjoint.shape
    score = np.zeros((e, t + 1, m))
    score[:, 1:] += adjoint * chain.mask[..., None]
    score[:, :-1] -= (chain.transition.swapaxes(2, 3) @ adjoint[..., None])[..., 0]
    if chain.memory is not None:
        earlier = chain.memory.earlier[:, 1:].swapaxes(2, 3)
        score[:, :-2] += (earlier @ adjoint[:, 1:, :, None])[..., 0]
    return score


Product = Callable[[np.ndarray, np.ndarray], np.ndarray]


def score_covariance(
    chain: Chain, diagonal: np.ndarray, left: np.ndarray, outer: np.ndarray | None, inner: Product
) -> np.ndarray:
    """Covariances of those scores (E, T + 1, m, m) by `_matrices`, variances by `columnwise`, from
    the blocks of the inverse covariance."""
    transition, mask = chain.transition, chain.mask[..., None, None]
    own = inner(np.broadcast_to(np.eye(diagonal.shape[2]), diagonal.shape), diagonal * mask)
    chance = np.zeros((len(own), own.shape[1] + 1, *own.shape[2:]))
    chance[:, 1:] += own
    chance[:, :-1] += inner(transition, diagonal @ transition)
    now, before = transition[:, 1:], left[:, 1:]
    chance[:, 1:-1] -= inner(now, before) + inner(before, now)
    if chain.memory is not None and outer is not None:
        earlier = chain.memory.earlier[:, 1:]
        chance[:, :-2] += inner(earlier, diagonal[:, 1:] @ earlier)
        passed, now = left[:, 1:].swapaxes(2, 3) @ earlier, transition[:, :-1]
        chance[:, :-2] -= inner(now, passed) + inner(passed, now)
        before, earlier = outer[:, 2:], earlier[:, 1:]
        chance[:, 1:-2] += inner(before, earlier) + inner(earlier, before)
    return chance


def _matrices(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one.swapaxes(-1, -2) @ other


def columnwise(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Diagonal of the same product."""
    return np.einsum("...ij,...ij->...j", one, other)

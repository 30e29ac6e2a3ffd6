"""Residuals that are linear in all unknowns, and their maximum-likelihood fit.

    noise, normal = estimate(linear, start, known)
    change, covariance = normal.change()

`Linear` has residuals and how they would change; `Normal`, its normal equations under a noise, has
the log-likelihood of each episode as a function of a small change.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Array3, Mask, Matrix, Vector
from adr_service.criticism.noise import Chain, Noise, Whitener
from adr_service.criticism.variances import Ascent, lifted

_SETTLED, _MOST_STEPS = 0.3, 60  # [nats] that a step gains at least
_RIDGE = 1e-9  # of the information on a column
_DAMPING = (1e-3, 1e2)  # of Newton steps, relative to the information: least and most
_HARDER, _EASIER = 30.0, 3.0  # factors of it, after a step that failed and one that did not
_SHARES = (0.4, 0.7, 0.9)  # of its misfit that a transition may pass on
_EVIDENT = 4.0  # [nats] that passing it on gains, or it does not


@dataclass(frozen=True)
class Linear:
    """Residuals of all transitions, their derivatives, and a prior on the coefficients."""

    chain: Chain
    residual: Array3  # (E, T, m)
    columns: np.ndarray  # (E, T, m, p)
    mean: Vector  # (p,) of each column's coefficient, before the data
    precision: Vector  # (p,) of that prior; zero: no prior

    def remembering(self, share: float) -> "Linear":
        """The same data, where each transition passes on a share of its misfit."""
        if share == 0:
            return self
        chain = self.chain.remembering(share)
        assert chain.memory is not None
        new = chain.memory.innovations
        return replace(self, chain=chain, residual=new(self.residual), columns=new(self.columns))


@dataclass(frozen=True)
class Normal:
    """Normal equations of each episode: log-likelihoods as functions of a small change."""

    information: np.ndarray  # (E, p, p)
    score: Matrix  # (E, p)
    log_likelihood: Vector  # (E,) at no change
    mean: Vector  # (p,) of the change, before the data
    precision: Vector  # (p,)

    @classmethod
    def of(cls, whitener: Whitener, linear: Linear) -> "Normal":
        z = whitener.whiten(np.concatenate([linear.residual[..., None], linear.columns], axis=3))
        log_likelihood = whitener.log_likelihood(z[..., 0])
        inner = products(z[..., 1:], z)
        return cls(inner[..., 1:], inner[..., 0], log_likelihood, linear.mean, linear.precision)

    @classmethod
    def joined(cls, parts: "Sequence[Normal]") -> "Normal":
        """Normal equations of all episodes, from those of some at a time."""
        return replace(
            parts[0],
            information=np.concatenate([part.information for part in parts]),
            score=np.concatenate([part.score for part in parts]),
            log_likelihood=np.concatenate([part.log_likelihood for part in parts]),
        )

    def only(self, columns: Sequence[int]) -> "Normal":
        """Normal equations of some columns, beside which the others do not change."""
        which = np.asarray(columns, dtype=np.int64)
        return Normal(
            self.information[:, which[:, None], which],
            self.score[:, which],
            self.log_likelihood,
            self.mean[which],
            self.precision[which],
        )

    def absorbed(self, own: Sequence[int], others: Sequence[int]) -> Matrix:
        """(own, others) how much of their `own` columns does as much as possible of what each of
        the others does."""
        information = self.information.sum(axis=0)
        known = information[np.ix_(own, own)] + np.diag(self.precision[own])
        return inverse(known) @ information[np.ix_(own, others)]

    def change(self) -> tuple[Vector, Matrix]:
        """The most probable change (p,), and its covariance (p, p)."""
        covariance = inverse(self.information.sum(axis=0) + np.diag(self.precision))
        return covariance @ (self.score.sum(axis=0) + self.precision * self.mean), covariance

    def covariance(self) -> Matrix:
        """(p, p) covariance of the most probable change, by the differences between episodes.

        The sandwich estimate, which holds where residuals are neither Gaussian nor independent
        within an episode (Liang and Zeger, 1986), for few episodes.
        """
        change, model = self.change()
        apart = self.score - self.information @ change  # (E, p)
        return model @ (apart.T @ apart) @ model * len(apart) / self.freedom

    @property
    def freedom(self) -> int:
        """Degrees of freedom of `covariance`: episodes less columns, and half the episodes at
        least (simulated intervals cover 98.7 % or more with these, docs/decisions.md)."""
        count, p = self.score.shape
        return max(count - p, count // 2, 1)

    def best_log_likelihood(self, columns: slice = slice(None)) -> float:
        """Log-likelihood of all episodes, with the prior, after the best change of these columns
        alone."""
        precision, mean = self.precision[columns], self.mean[columns]
        information = self.information[:, columns, columns].sum(axis=0) + np.diag(precision)
        score = self.score[:, columns].sum(axis=0) + precision * mean
        before = self.log_likelihood.sum() - 0.5 * self.precision @ self.mean**2
        return float(before + 0.5 * score @ inverse(information) @ score)

    def left_out(self) -> Vector:
        """(E,) log-likelihood of each episode, by a fit to all the others."""
        rest = self.information.sum(axis=0) - self.information + np.diag(self.precision)
        score = self.score.sum(axis=0) - self.score + self.precision * self.mean
        change = np.einsum("eij,ej->ei", inverse(rest), score)
        bend = np.einsum("ei,eij,ej->e", change, self.information, change)
        return self.log_likelihood + np.einsum("ei,ei->e", self.score, change) - 0.5 * bend


def estimate(linear: Linear, start: Noise, known: Mask) -> tuple[Noise, Normal]:
    """Maximum-likelihood noise of the residuals that the columns leave, from `start`, and the
    normal equations under it.

    `known` (m,): sensors whose variances stay. A step that makes the residuals less probable is
    damped.
    """
    whitener, normal = _judged(linear, start)
    whitener.keep()
    reached, damping = normal.best_log_likelihood(), _DAMPING[0]
    for _ in range(_MOST_STEPS):
        left = linear.residual - linear.columns @ normal.change()[0]
        ascent, before = Ascent.of(whitener, left), reached
        while damping <= _DAMPING[1]:
            try:
                tried = _judged(linear, ascent.step(known, damping))
            except np.linalg.LinAlgError:  # variances too far apart
                damping *= _HARDER
                continue
            if tried[1].best_log_likelihood() >= before:
                (whitener, normal), reached = tried, tried[1].best_log_likelihood()
                break
            damping *= _HARDER
        if reached - before < _SETTLED:
            break
        damping = max(damping / _EASIER, _DAMPING[0])
    whitener.keep()
    return whitener.noise, normal


@dataclass(frozen=True)
class Persistence:
    """The share of its misfit that a transition passes on, and the noise that fits it."""

    share: float  # zero: nothing
    noise: Noise


def persistence_of(linear: Linear, noise: Noise, known: Mask) -> Persistence:
    """The likeliest share that misfit passes on, zero unless that is evident; `noise` is the best
    where it passes on nothing."""
    reached, best = likelihood(linear, noise) + _EVIDENT, Persistence(0.0, noise)
    for share in _SHARES:
        try:
            noise, normal = persisting(linear, share, [noise], known)
        except np.linalg.LinAlgError:  # variances too far apart
            break
        if not normal.best_log_likelihood() > reached:
            break
        reached, best = normal.best_log_likelihood(), Persistence(share, noise)
    return best


def persisting(
    linear: Linear, share: float, starts: Sequence[Noise], known: Mask
) -> tuple[Noise, Normal]:
    """`estimate` where each transition passes on a share of its misfit, from the likeliest of some
    noises."""
    linear = linear.remembering(share)
    lift = [lifted(noise, linear.chain, linear.residual, known) for noise in starts]
    return estimate(linear, max(lift, key=lambda noise: likelihood(linear, noise)), known)


def likelihood(linear: Linear, noise: Noise, columns: slice = slice(None)) -> float:
    """Log-likelihood of all residuals under a noise, with the best coefficients of these columns;
    minus infinity for variances that are too far apart."""
    try:
        whitener, normal = _judged(linear, noise)
    except np.linalg.LinAlgError:
        return -np.inf
    whitener.keep()
    return normal.best_log_likelihood(columns)


def products(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(E, i, j) inner products of columns (E, T, m, i) and (E, T, m, j), by episode."""
    e, t, m, i = one.shape
    return one.reshape(e, t * m, i).swapaxes(1, 2) @ other.reshape(e, t * m, -1)


def inverse(information: np.ndarray) -> np.ndarray:
    """Inverse of normal matrices (..., p, p), whose columns may differ by many orders.

    Zero for columns without information, huge for those that only a combination determines.
    """
    diagonal = np.diagonal(information, axis1=-2, axis2=-1)
    scale = np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, 0.0)), np.inf)
    outer = scale[..., :, None] * scale[..., None, :]
    return np.linalg.inv(information / outer + _RIDGE * np.eye(diagonal.shape[-1])) / outer


def _judged(linear: Linear, noise: Noise) -> tuple[Whitener, Normal]:
    whitener = Whitener.of(linear.chain, noise)
    return whitener, Normal.of(whitener, linear)

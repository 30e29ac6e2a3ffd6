"""Trust-region search for the Gaussian of parameters under which measurements are likely.

    search = TrustRegion(evaluate, measured, epsilon, bounds)
    best, path = search.minimise(mean, std, budget=5000, progress=silent)

`evaluate` simulates draws of a Gaussian and returns the negative log likelihood of `measured`
(w, s) under the mean and covariance of the predictions, plus `epsilon` on the diagonal, summed
over windows. The draws of two Gaussians should differ by shift and scale alone (common random
numbers). Where a feasible bound cuts them, the linear model is less exact, not the search.

Each step linearises the predictions by regression on the draws (statistical linearisation, Särkkä:
"Bayesian Filtering and Smoothing", 2013, Sec. 5.4), and minimises the likelihood of that linear
model within a trust region (Nocedal and Wright: "Numerical Optimization", 2006, Algorithm 4.1,
but a poor step halves the radius, and any good one doubles it).
Draws that are wide smooth the contacts out of the predictions, and they narrow as the fit improves.
Every accepted Gaussian was simulated, so no loss is a guess.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.optimize import minimize

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.errors import InvalidInput
from adr_service.progress import Progress

_MOST_RADIUS = 2.0  # standard deviations, or their logarithms; the draws end there
_LEAST_RADIUS = 0.02  # below it, the roughness of the loss hides its slope
_NEGLIGIBLE = 0.01  # gain of log likelihood for which no step is worth its simulation [nat]
_POOR, _GOOD = 0.25, 0.75  # ratios of the gain to the model's (Algorithm 4.1)
# evaluations of a search: 218 of the Hopper study's 225 take no more, one takes 105
USUAL_EVALUATIONS = 35
_NARROWER = 4.0  # divides the deviations of a start that diverges


@dataclass(frozen=True)
class Evaluation:
    """A Gaussian whose draws were simulated."""

    mean: Vector  # (d,)
    std: Vector  # (d,)
    loss: float  # negative log likelihood [nat], less a bonus; infinite if none can be computed
    draws: Matrix  # (k, d)
    predictions: Array3  # (k, w, s)


@dataclass(frozen=True)
class Bounds:
    """Bounds of the search, (d,) each."""

    mean_low: Vector
    mean_high: Vector
    std_low: Vector
    std_high: Vector


@dataclass(frozen=True)
class Step:
    """One evaluation of a search, and what the linear model had predicted for it [nat]."""

    loss: float
    predicted_loss: float | None  # None: of the start
    radius: float


@dataclass(frozen=True)
class Path:
    """The evaluations of a search, and the reason for its end."""

    steps: list[Step]
    stopped_by: Literal["converged", "rough", "budget"]


@dataclass(frozen=True)
class TrustRegion:
    """The search. `evaluate` takes the mean and the standard deviations, (d,) each."""

    evaluate: Callable[[Vector, Vector], Evaluation]
    measured: Matrix  # (w, s)
    epsilon: float
    bounds: Bounds
    entropy: float = 0.0  # nats that `evaluate` takes off its loss per logarithm of each deviation

    def minimise(
        self, mean: Vector, std: Vector, *, budget: int, progress: Progress
    ) -> tuple[Evaluation, Path]:
        """The best Gaussian within `budget` evaluations, and the way to it.

        A start whose draws diverge is narrowed until they do not.
        """
        best, spent = self._start(mean, std, budget, progress)
        model, radius = self._model(best), 1.0
        steps = [Step(best.loss, None, radius)]
        while radius >= _LEAST_RADIUS:
            move, expected = model.least(*self._room(best, radius, model.linear.notable))
            if expected < _NEGLIGIBLE:
                if not model.moves:
                    return best, Path(steps, "converged")
                # the correction may hide a descent
                model, radius = self._model(best), radius / 2
                continue
            if spent == budget:
                return best, Path(steps, "budget")
            tried, spent = self.evaluate(*self._moved(best, move)), spent + 1
            steps.append(Step(tried.loss, best.loss - expected, radius))
            radius = _adapted(radius, (best.loss - tried.loss) / expected)
            if tried.loss < best.loss:
                best, model = tried, self._model(tried)
            else:
                model = model.corrected(move, tried.loss - best.loss)
            progress(_fraction(spent, budget), evaluations=spent, loss=best.loss)
        return best, Path(steps, "rough")

    def _model(self, at: Evaluation) -> "CorrectedModel":
        return CorrectedModel(Linearisation.around(at, self.measured, self.epsilon, self.entropy))

    def _start(
        self, mean: Vector, std: Vector, budget: int, progress: Progress
    ) -> tuple[Evaluation, int]:
        """The first Gaussian whose loss is finite, and the evaluations until it."""
        for spent in range(1, budget + 1):
            if spent > 1:
                std = np.maximum(std / _NARROWER, self.bounds.std_low)
            start = self.evaluate(mean, std)
            progress(_fraction(spent, budget), evaluations=spent)
            if np.isfinite(start.loss):
                return start, spent
            if np.all(std <= self.bounds.std_low):
                break
        raise InvalidInput(
            f"simulation diverged for draws around {mean.tolist()}, or they spread too far for "
            f"epsilon, with every standard deviation that was tried, down to {std.tolist()}"
        )

    def _room(self, at: Evaluation, radius: float, notable: Vector) -> tuple[Vector, Vector]:
        """The lowest and the highest move (2d,) within the bounds and the trust region.

        The mean moves by `radius` standard deviations, or by as many `notable` shifts (d,).
        """
        bounds, most = self.bounds, radius * np.concatenate([notable, np.ones(len(notable))])
        low = [(bounds.mean_low - at.mean) / at.std, np.log(bounds.std_low / at.std)]
        high = [(bounds.mean_high - at.mean) / at.std, np.log(bounds.std_high / at.std)]
        return np.clip(np.concatenate(low), -most, 0), np.clip(np.concatenate(high), 0, most)

    def _moved(self, at: Evaluation, move: Vector) -> tuple[Vector, Vector]:
        """Mean and standard deviations after a move (2d,)."""
        shift, growth = np.split(move, 2)
        bounds = self.bounds
        return (
            np.clip(at.mean + at.std * shift, bounds.mean_low, bounds.mean_high),
            np.clip(at.std * np.exp(growth), bounds.std_low, bounds.std_high),
        )


def _fraction(spent: int, budget: int) -> float:
    """Share of the evaluations that a search usually takes."""
    return min(spent / min(budget, USUAL_EVALUATIONS), 1.0)


def _adapted(radius: float, gain: float) -> float:
    """The next radius, after a step with this ratio of the gain to the model's."""
    if gain < _POOR:
        return radius / 2
    return min(2 * radius, _MOST_RADIUS) if gain > _GOOD else radius


@dataclass(frozen=True)
class Linearisation:
    """Predictions of every window as a linear function of the draws, with Gaussian residuals.

    Draws are in standard deviations from the Gaussian's mean. For a Gaussian that is moved by
    `shift` a and `growth` b, with D = diag(exp(b)):

        y_w ~ N(m_w + G_w (a + (D - I) c), G_w D V D G_w' + R_w)
    """

    missed: Matrix  # (w, s) y_w - m_w
    slopes: Array3  # (w, s, d) G_w, per standard deviation
    centre: Vector  # (d,) c, mean of the draws; not 0 where a feasible bound cuts them
    spread: Matrix  # (d, d) V, their covariance
    residual: Array3  # (w, s, s) R_w, covariance of what the slopes leave, and epsilon
    entropy: float  # nats that growth is worth

    @classmethod
    def around(
        cls, at: Evaluation, measured: Matrix, epsilon: float, entropy: float = 0.0
    ) -> "Linearisation":
        """The regression of the predictions on the draws."""
        k, w, s = at.predictions.shape
        middle = at.predictions.mean(axis=0)
        draws = (at.draws - at.mean) / at.std
        centre = draws.mean(axis=0)
        draws = draws - centre
        centred = (at.predictions - middle).reshape(k, w * s)
        slopes = np.asarray(np.linalg.lstsq(draws, centred, rcond=None)[0], dtype=np.float64)
        left = (centred - draws @ slopes).reshape(k, w, s).transpose(1, 2, 0)
        # divided as the sample covariance, so that the model is exact where it was made
        residual = left @ left.transpose(0, 2, 1) / (k - 1) + epsilon * np.eye(s)
        spread = draws.T @ draws / (k - 1)
        slopes = slopes.reshape(-1, w, s).transpose(1, 2, 0)
        return cls(measured - middle, slopes, centre, spread, residual, entropy)

    @cached_property
    def notable(self) -> Vector:
        """Shifts (d,) that cost half a nat, at least one standard deviation.

        Draws that have collapsed say nothing of the distance over which predictions are linear.
        """
        information = np.einsum(
            "wsd,wst,wtd->d", self.slopes, np.linalg.inv(self.residual), self.slopes, optimize=True
        )
        return np.maximum(1.0, 1 / np.sqrt(np.maximum(information, np.finfo(float).tiny)))

    def loss(self, move: Vector) -> tuple[float, Vector]:
        """The negative log likelihood after a move (2d,), shift and growth, and its gradient."""
        shift, growth = np.split(move, 2)
        scale = np.exp(growth)
        spread = scale[:, None] * self.spread * scale  # D V D
        covariance = self.slopes @ spread @ self.slopes.transpose(0, 2, 1) + self.residual
        inverse, log_det = np.linalg.inv(covariance), np.linalg.slogdet(covariance)[1]
        missed = self.missed - self.slopes @ (shift + (scale - 1) * self.centre)
        white = np.squeeze(inverse @ missed[..., None], axis=2)  # C^-1 r
        value = np.sum(white * missed) + np.sum(log_det) + missed.size * np.log(2 * np.pi)
        pulls = np.squeeze(white[:, None] @ self.slopes, axis=1)  # (w, d) G' C^-1 r
        # sum_w G' (C^-1 - C^-1 r r' C^-1) G
        curvature = np.sum(self.slopes.transpose(0, 2, 1) @ inverse @ self.slopes, axis=0)
        curvature -= pulls.T @ pulls
        pull = pulls.sum(axis=0)
        growing = np.sum(curvature * spread, axis=1) - pull * scale * self.centre
        loss = float(value) / 2 - self.entropy * float(growth.sum())
        return loss, np.concatenate([-pull, growing - self.entropy])


@dataclass(frozen=True)
class CorrectedModel:
    """The linear model's loss, corrected so that it is right at the moves that were no gain.

    What the predictions leave over also changes with a move, which the linear model does not see.
    The correction is the smallest sum of multiples of coordinates and of their squares.
    """

    linear: Linearisation
    moves: tuple[Vector, ...] = ()  # (2d,) each
    missed: tuple[float, ...] = ()  # rise of the loss that the linear model did not see there [nat]

    def corrected(self, move: Vector, rise: float) -> "CorrectedModel":
        """The model that knows how a move raised the loss, if it did not diverge."""
        if not np.isfinite(rise):
            return self
        missed = rise - (self.linear.loss(move)[0] - self.linear.loss(np.zeros(len(move)))[0])
        return CorrectedModel(self.linear, (*self.moves, move), (*self.missed, missed))

    def loss(self, move: Vector) -> tuple[float, Vector]:
        """The negative log likelihood after a move (2d,), and its gradient."""
        slopes, squares = self._correction
        value, gradient = self.linear.loss(move)
        value += float(slopes @ move + squares @ move**2)
        return value, gradient + slopes + 2 * squares * move

    def least(self, low: Vector, high: Vector) -> tuple[Vector, float]:
        """The best move (2d,) between two moves, and by how much it should lower the loss."""
        none, box = np.zeros(len(low)), np.stack([low, high], axis=1)
        found = minimize(self.loss, none, jac=True, method="L-BFGS-B", bounds=box)
        return np.asarray(found.x), self.loss(none)[0] - float(found.fun)

    @cached_property
    def _correction(self) -> tuple[Vector, Vector]:
        """Factors (2d,) of the coordinates and of their squares."""
        n = 2 * len(self.linear.centre)
        if not self.moves:
            return np.zeros(n), np.zeros(n)
        moves = np.array(self.moves)
        room = np.concatenate([self.linear.notable, np.ones(n // 2)])
        # in units of the longest move, a coordinate and its square weigh the same
        unit = room * np.abs(moves / room).max()
        features = np.concatenate([moves / unit, (moves / unit) ** 2], axis=1)
        factors = np.linalg.lstsq(features, np.array(self.missed), rcond=1e-6)[0]
        slopes, squares = np.split(np.asarray(factors, dtype=np.float64), 2)
        return slopes / unit, squares / unit**2

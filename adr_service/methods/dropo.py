"""DROPO: maximise the likelihood of recorded transitions under randomised simulation.

Tiboni, Arndt, Kyrki: "DROPO: Sim-to-Real Transfer with Offline Domain Randomization",
arXiv 2201.08434, with the settings of the benchmark (sample size 10 per parameter).

Where we differ from the published code, and why:
- One set of random numbers (a Latin hypercube) serves all candidates, so the objective is a
  deterministic function of the distribution and its best evaluation is not a lucky one.
- Every recorded transition counts, the last of an episode too: its next observation is recorded.
- One diverged draw makes a candidate the worst; how many did is in the diagnostics.
- Bounds are pycma's transformation, not the 'bouncing' of the library they used.
- Draws below the feasible bound are excluded by inversion, not clamped after 20 redraws.
- pycma with full covariance and an initial step of 1 in [0, 4], which is what "identity
  starting covariance" in the paper was under the optimiser library of its time.
- The search evaluates an emulator of the replay (`simulation.emulator`), fitted to a box around
  the population and refitted as that moves or shrinks; what it misses, measured on held-out
  simulations, is added to the predicted variance. `exact` simulates every draw of every candidate
  instead, as the paper does. Either way the estimate is judged by simulation.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, PositiveFloat
from scipy.stats import qmc

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.distributions import TruncatedGaussian
from adr_service.errors import InvalidInput
from adr_service.methods.base import Estimate, Grid, OfflineSettings, Problem
from adr_service.parameters import ParameterSpace
from adr_service.progress import Progress
from adr_service.search.cma_es import strategy
from adr_service.simulation.emulator import Emulator, draws_to_fit
from adr_service.simulation.replay import Replay
from adr_service.transitions import TransitionDataset

_WORST = 1e12  # loss of a candidate whose simulation diverged; CMA-ES compares ranks only
_MARGIN = 2.5  # of the emulator's box over the draws of a population
_SHRUNK = 0.2  # share of the box below which a population gets an emulator of its own
_TOGETHER = 16  # simulations at a time; changes no bit
_NEGLIGIBLE = 0.01  # emulation error, as a variance, in epsilons
_EMULATORS = 8  # fitted by one search, from runs on `arm` and `hopper`: 3 to 8


_Several = Annotated[list[PositiveFloat], Field(min_length=2, max_length=100)]


class DropoSettings(OfflineSettings):
    name: Literal["dropo"] = "dropo"
    budget: int = Field(5000, ge=1, le=1_000_000, description="likelihood evaluations")
    samples_per_parameter: int = Field(
        10, ge=2, le=1000, description="draws per evaluation and parameter"
    )
    epsilon: PositiveFloat | _Several = Field(
        [1e-6, 1e-5, 1e-4, 1e-3, 1e-2],
        description="variance added to every observed column; of several, that whose estimated "
        "mean predicts best (Sec. IV-A)",
    )
    steps: int = Field(1, ge=1, le=10_000, description="control steps per replayed window (lambda)")
    exact: bool = Field(False, description="simulate every draw of every candidate")

    # Sec. IV-A: epsilon by the error of one-step predictions by the estimate's mean
    grid: ClassVar[Grid | None] = Grid("epsilon", criterion="mean_squared_error")
    label: ClassVar[str] = "DROPO"
    colour: ClassVar[str] = "#D55E00"

    def create(self) -> "Dropo":
        return Dropo(self)

    def planned_steps(self, parameters: int, transitions: int) -> int:
        draws = _EMULATORS * draws_to_fit(parameters)
        if self.exact:
            draws = self.budget * self.samples_per_parameter * parameters
        return draws * transitions


class Dropo:
    def __init__(self, settings: DropoSettings):
        """`settings` have one epsilon (`MethodSettings.each`)."""
        if isinstance(settings.epsilon, list):
            raise InvalidInput(f"one search has one epsilon; given {settings.epsilon}")
        self._settings, self._epsilon = settings, settings.epsilon

    def fit(
        self,
        problem: Problem,
        data: TransitionDataset,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Estimate:
        settings, space = self._settings, problem.source.space
        k = settings.samples_per_parameter * len(space)
        levels = qmc.LatinHypercube(len(space), rng=rng).random(k)
        replay = Replay(problem.task, problem.source, data, _TOGETHER, settings.steps)
        if not len(replay.targets):
            raise InvalidInput(
                f"no episode has the {settings.steps} consecutive transitions that one window "
                f"needs; the data are {data!r}"
            )
        exact = Exact(space, levels, replay, self._epsilon)
        objective = exact if settings.exact else Emulated(exact, rng)
        found, evaluations = minimise(objective, 2 * len(space), settings.budget, rng, progress)
        judged, searched, x = min(
            ((exact.loss(x), loss, x) for x, loss in found), key=lambda end: end[0]
        )
        if judged >= _WORST:
            raise InvalidInput(f"all {evaluations} candidates diverged in simulation")
        estimate, windows = decode(space, x), len(replay.targets)
        return Estimate(
            estimate,
            simulated_steps=exact.replayed * windows * settings.steps,
            diagnostics={
                "loss_per_window": judged / windows,
                "searched_loss_per_window": searched / windows,
                "mean_squared_error": float(replay.mean_squared_error(estimate.mean[None])[0]),
                "evaluations": evaluations,
                "searches": len(found),
                "diverged_evaluations": exact.diverged,
                "epsilon": self._epsilon,
                **objective.diagnostics,
            },
        )


class Exact:
    """DROPO's loss of search points, every draw simulated."""

    era = 0  # losses of one era can be compared
    diagnostics: Mapping[str, Any] = MappingProxyType({})

    def __init__(self, space: ParameterSpace, levels: Matrix, replay: Replay, epsilon: float):
        self.space, self.replay, self.epsilon = space, replay, epsilon
        self._levels = levels
        self.replayed = 0  # draws of dynamics that were simulated
        self.diverged = 0  # candidates with a diverged draw

    def draws(self, x: Vector) -> Matrix:
        """The dynamics (k, d) that stand for the distribution at a search point."""
        return decode(self.space, x).quantile(self._levels)

    def loss(self, x: Vector) -> float:
        predictions = self.replay.predict(self.draws(x))
        self.replayed += len(predictions)
        if not np.all(np.isfinite(predictions)):
            self.diverged += 1
            return _WORST
        return -log_likelihood(predictions, self.replay.targets, self.epsilon)

    def losses(self, population: Sequence[Vector]) -> list[float]:
        return [self.loss(x) for x in population]


class Emulated:
    """The same loss by an emulator whose error, where it has one, is one more variance.

    A population that has left the emulator's box, or that fills little of it while the error
    still matters, gets an emulator of its own; that begins a new era.
    """

    def __init__(self, exact: Exact, rng: np.random.Generator):
        self._exact, self._rng, self.era = exact, rng, 0
        self._history: list[dict[str, float]] = []
        width = exact.space.high - exact.space.low
        # all that draws can reach: the largest deviation is width / 4, cut at two
        self._reach = (
            np.maximum(exact.space.feasible_low, exact.space.low - width / 2),
            exact.space.high + width / 2,
        )
        self._emulator = self._fit(*self._reach)

    @property
    def diagnostics(self) -> dict[str, Any]:
        return {"emulators": self._history}

    def losses(self, population: Sequence[Vector]) -> list[float]:
        draws = np.concatenate([self._exact.draws(x) for x in population])
        share = self._emulator.share(draws)
        outside, shrunk = share > 1, np.all(share < _SHRUNK) and self._matters
        if outside.any() or shrunk:
            low, high = widened(draws.min(axis=0), draws.max(axis=0), _MARGIN)
            least, most = self._reach
            self._emulator = self._fit(np.maximum(low, least), np.minimum(high, most))
            self.era += 1
        return [self.loss(x) for x in population]

    def loss(self, x: Vector) -> float:
        """The loss of one point; infinite where the present emulator does not reach."""
        draws = self._exact.draws(x)
        if (self._emulator.share(draws) > 1).any():
            return np.inf
        variance = self._exact.epsilon + self._emulator.error**2
        return -log_likelihood(self._emulator.predict(draws), self._exact.replay.targets, variance)

    @property
    def _matters(self) -> bool:
        """Whether the emulation error is not negligible beside epsilon."""
        return self._history[-1]["mean_squared_error"] > _NEGLIGIBLE * self._exact.epsilon

    def _fit(self, low: Vector, high: Vector) -> Emulator:
        emulator = Emulator.fit(self._exact.replay, low, high, self._rng)
        self._exact.replayed += emulator.simulated
        error = float(np.mean(emulator.error**2))
        self._history.append(
            {
                "mean_squared_error": error,
                "draws": emulator.simulated,
                "diverged_draws": emulator.diverged,
            }
        )
        return emulator


def widened(low: Vector, high: Vector, margin: float) -> tuple[Vector, Vector]:
    """An interval `margin` times as wide about the same middle."""
    middle, half = (low + high) / 2, margin * (high - low) / 2
    return middle - half, middle + half


def minimise(
    objective: Exact | Emulated,
    dimension: int,
    budget: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[tuple[Vector, float]], int]:
    """CMA-ES from the middle of the box, restarted until the budget is spent.

    Returns the end of each search, its best point and its loss (of the last era, so that those
    of two searches cannot be compared), and the evaluations.
    """
    found: list[tuple[Vector, float]] = []
    evaluations = 0
    while evaluations < budget:
        best_x, best, era = np.full(dimension, 2.0), np.inf, objective.era
        es = strategy(np.full(dimension, 2.0), std=1.0, width=ParameterSpace.WIDTH, rng=rng)
        while evaluations < budget and not es.stop():
            candidates = es.ask()
            losses = objective.losses(candidates)
            es.tell(candidates, losses)
            evaluations += len(candidates)
            if objective.era != era:
                best, era = objective.loss(best_x), objective.era
            if min(losses) < best:
                best, best_x = min(losses), np.array(candidates[int(np.argmin(losses))])
            progress(evaluations / budget, evaluations=evaluations, loss=best)
        found.append((best_x, best))
    return found, evaluations


def decode(space: ParameterSpace, x: Vector) -> TruncatedGaussian:
    """The distribution at a search point: means, then log-scaled deviations, all in [0, 4]."""
    d, width = len(space), space.high - space.low
    low = np.minimum(1e-5, width / 8 - 1e-5)
    high = width / 4
    std = low * (high / low) ** (x[d:] / space.WIDTH)
    return TruncatedGaussian(space, space.denormalise(x[:d]), std)


def log_likelihood(predictions: Array3, targets: Matrix, variance: float | Matrix) -> float:
    """Sum over windows of log N(target; mean, covariance + variance) of the draws' predictions.

    predictions (k, w, s), targets (w, s); variance of every column (epsilon), or (w, s).
    """
    k, _, s = predictions.shape
    mean = predictions.mean(axis=0)
    centred = (predictions - mean).transpose(1, 2, 0)  # (w, s, k)
    covariance = centred @ centred.transpose(0, 2, 1) / (k - 1)
    covariance[:, np.arange(s), np.arange(s)] += variance
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, (targets - mean)[..., None])[..., 0]
    log_det = 2 * np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)))
    return float(-0.5 * (np.sum(white**2) + log_det + targets.size * np.log(2 * np.pi)))

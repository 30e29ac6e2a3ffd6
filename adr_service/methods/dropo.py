"""DROPO: maximise the likelihood of recorded transitions under randomised simulation.

Tiboni, Arndt, Kyrki: "DROPO: Sim-to-Real Transfer with Offline Domain Randomization", arXiv
2201.08434, with the benchmark's settings (sample size 10 per parameter; Tiboni et al., Sec. 3.2).
Functions in brackets are those of the authors' code, github.com/gabrieletiboni/dropo.

Where we differ from that code, and why:
- One set of random numbers (a Latin hypercube) serves all candidates. So the objective is a
  deterministic function of the distribution, and the best evaluation is not a lucky one.
- Every recorded transition counts, also the last of an episode: its next observation is recorded.
- One diverged draw makes a candidate the worst. Diagnostics count those candidates.
- pycma's transformation keeps the search inside its bounds, not the 'bouncing' of nevergrad.
- Draws below the feasible bound are excluded by inversion, not clamped after 20 redraws.
- The search is pycma's, with full covariance and an initial step of 1 in [0, 4]. nevergrad had
  these settings when the paper called them an "identity starting covariance".
- The search evaluates an emulator of the replay (`simulation.emulator`), fitted to a box around
  the population, and fitted again when the population moves or shrinks. The emulator's error on
  held-out simulations is added to the predicted variance. The setting `exact` simulates every draw
  of every candidate instead, as the paper does. Either way, simulation judges the estimate.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
_MARGIN = 2.5  # width of the emulator's box, in ranges of a population's draws
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
        description="variance added to every observed column; of several values, the one whose "
        "estimated mean predicts best (Sec. IV-A)",
    )
    steps: int = Field(1, ge=1, le=10_000, description="control steps per replayed window (lambda)")
    exact: bool = Field(False, description="simulate every draw of every candidate")

    # Sec. IV-A, `MSE_trajectories`: the error of one-step predictions by the estimate's mean
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
        settings, d = self._settings, len(problem.source.space)
        # one set of levels for all candidates, K = 10 d (benchmark, Sec. 3.2)
        levels = qmc.LatinHypercube(d, rng=rng).random(settings.samples_per_parameter * d)
        replay = self._replay(problem, data)
        exact = Exact(problem.source.space, levels, replay, self._epsilon)
        objective = exact if settings.exact else Emulated(exact, rng)
        ends, evaluations = minimise(objective, 2 * d, settings.budget, rng, progress)
        estimate, losses = self._best(ends, exact, evaluations)
        return Estimate(
            estimate,
            simulated_steps=exact.replayed * len(replay.targets) * settings.steps,
            diagnostics={
                **losses,
                "mean_squared_error": float(replay.mean_squared_error(estimate.mean[None])[0]),
                "evaluations": evaluations,
                "searches": len(ends),
                "diverged_evaluations": exact.diverged,
                "epsilon": self._epsilon,
                **objective.diagnostics,
            },
        )

    def _best(
        self, ends: "list[End]", exact: "Exact", evaluations: int
    ) -> tuple[TruncatedGaussian, dict[str, float]]:
        """The best end of all searches by simulation, with its losses."""
        judged = [exact.loss(end.x) for end in ends]
        loss, best = min(zip(judged, ends, strict=True), key=lambda pair: pair[0])
        if loss >= _WORST:
            raise InvalidInput(f"all {evaluations} candidates diverged in simulation")
        n = len(exact.replay.targets)
        losses = {"loss_per_window": loss / n, "searched_loss_per_window": best.loss / n}
        return decode(exact.space, best.x), losses

    def _replay(self, problem: Problem, data: TransitionDataset) -> Replay:
        """A replay of the data's windows of lambda steps."""
        steps = self._settings.steps
        replay = Replay(problem.task, problem.source, data, _TOGETHER, steps)
        if not len(replay.targets):
            raise InvalidInput(
                f"no episode has the {steps} consecutive transitions that one window needs; "
                f"the data are {data!r}"
            )
        return replay


def log_likelihood(predictions: Array3, targets: Matrix, variance: float | Matrix) -> float:
    """Log likelihood of the targets under the draws' predictions, summed over windows.

    Predictions are (k, w, s), targets (w, s); the variance is that of every column (epsilon), or
    (w, s). `_L_target_given_phi_trajectories` is the negative of this sum:

        sum_w log N(s'_w; m_w, C_w + epsilon I), m_w and C_w over the k draws
    """
    k, _, s = predictions.shape
    mean = predictions.mean(axis=0)
    centred = (predictions - mean).transpose(1, 2, 0)  # (w, s, k)
    covariance = centred @ centred.transpose(0, 2, 1) / (k - 1)  # unbiased, as np.cov
    covariance[:, np.arange(s), np.arange(s)] += variance
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, (targets - mean)[..., None])[..., 0]
    log_det = 2 * np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)))
    return float(-0.5 * (np.sum(white**2) + log_det + targets.size * np.log(2 * np.pi)))


def decode(space: ParameterSpace, x: Vector) -> TruncatedGaussian:
    """The distribution at a search point x in [0, 4]^2d: means, then log-scaled deviations.

    As `_denormalize_bounds` with `logstdevs`: mu = low + x (high - low) / 4, and
    sigma = sigma_low (sigma_high / sigma_low)^(x / 4). Draws are cut at two deviations, as in
    `sample_truncnormal`.
    """
    d, width = len(space), space.high - space.low
    low = np.minimum(1e-5, width / 8 - 1e-5)  # the authors' `stdev_lower_bound`
    high = width / 4  # and `stdev_upper_bound`
    std = low * (high / low) ** (x[d:] / space.WIDTH)
    return TruncatedGaussian(space, space.denormalise(x[:d]), std)


class Exact:
    """DROPO's loss of search points, with every draw simulated."""

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
        """The negative log likelihood at a search point; `_WORST` if a draw diverged."""
        predictions = self.replay.predict(self.draws(x))
        self.replayed += len(predictions)
        if not np.all(np.isfinite(predictions)):
            self.diverged += 1
            return _WORST
        return -log_likelihood(predictions, self.replay.targets, self.epsilon)

    def losses(self, population: Sequence[Vector]) -> list[float]:
        """The losses of a population."""
        return [self.loss(x) for x in population]


class Emulated:
    """DROPO's loss of search points, by an emulator whose error adds to the variance.

    A population gets an emulator of its own if it has left the present emulator's box, or if it
    fills little of the box while the emulation error still matters. Each emulator begins an era.
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
        """Errors and costs of all emulators so far."""
        return {"emulators": self._history}

    def losses(self, population: Sequence[Vector]) -> list[float]:
        """The losses of a population, all by one emulator."""
        draws = np.concatenate([self._exact.draws(x) for x in population])
        share = self._emulator.share(draws)
        outside, shrunk = share > 1, np.all(share < _SHRUNK) and self._matters
        if outside.any() or shrunk:
            self._emulator = self._fit(*self._around(draws))
            self.era += 1
        return [self.loss(x) for x in population]

    def loss(self, x: Vector) -> float:
        """The loss at a search point; infinite if a draw lies outside the emulator's box."""
        draws = self._exact.draws(x)
        if (self._emulator.share(draws) > 1).any():
            return np.inf
        variance = self._exact.epsilon + self._emulator.error**2
        return -log_likelihood(self._emulator.predict(draws), self._exact.replay.targets, variance)

    @property
    def _matters(self) -> bool:
        """True if the emulation error is not negligible beside epsilon."""
        return self._history[-1]["mean_squared_error"] > _NEGLIGIBLE * self._exact.epsilon

    def _around(self, draws: Matrix) -> tuple[Vector, Vector]:
        """The box `_MARGIN` times as wide as the draws, within reach."""
        low, high = draws.min(axis=0), draws.max(axis=0)
        middle, half = (low + high) / 2, _MARGIN * (high - low) / 2
        least, most = self._reach
        return np.maximum(middle - half, least), np.minimum(middle + half, most)

    def _fit(self, low: Vector, high: Vector) -> Emulator:
        emulator = Emulator.fit(self._exact.replay, low, high, self._rng)
        self._exact.replayed += emulator.simulated
        error, draws = float(np.mean(emulator.error**2)), emulator.simulated
        facts = {"mean_squared_error": error, "draws": draws, "diverged_draws": emulator.diverged}
        self._history.append(facts)
        return emulator


@dataclass(frozen=True)
class End:
    """The best point of one search."""

    x: Vector  # (2d,) in [0, 4]
    loss: float  # of the search's last era, so that losses of two searches cannot be compared


def minimise(
    objective: Exact | Emulated,
    dimension: int,
    budget: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[End], int]:
    """The ends of CMA-ES searches, restarted until the budget is spent, and all evaluations."""
    ends: list[End] = []
    evaluations, middle = 0, np.full(dimension, ParameterSpace.WIDTH / 2)
    while evaluations < budget:
        # a step of 1 is the paper's identity starting covariance
        es = strategy(middle, std=1.0, width=ParameterSpace.WIDTH, rng=rng)
        best, era = End(middle, np.inf), objective.era
        while evaluations < budget and not es.stop():
            candidates = es.ask()
            losses = objective.losses(candidates)
            es.tell(candidates, losses)
            evaluations += len(candidates)
            if objective.era != era:
                best, era = End(best.x, objective.loss(best.x)), objective.era
            if min(losses) < best.loss:
                best = End(np.array(candidates[int(np.argmin(losses))]), min(losses))
            progress(min(evaluations / budget, 1.0), evaluations=evaluations, loss=best.loss)
        ends.append(best)
    return ends, evaluations

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
"""

from collections.abc import Callable
from typing import Literal

import cma
import numpy as np
from pydantic import Field
from scipy.stats import qmc

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.distributions import TruncatedGaussian
from adr_service.errors import InvalidInput
from adr_service.methods.base import Estimate, Problem
from adr_service.parameters import ParameterSpace
from adr_service.progress import Progress
from adr_service.simulation.replay import Replay
from adr_service.transitions import TransitionDataset
from adr_service.wire import Wire

_WORST = 1e12  # loss of a candidate whose simulation diverged; CMA-ES compares ranks only


class DropoSettings(Wire):
    name: Literal["dropo"] = "dropo"
    budget: int = Field(5000, ge=1, le=1_000_000, description="likelihood evaluations")
    samples_per_parameter: int = Field(
        10, ge=2, le=1000, description="draws per evaluation and parameter"
    )
    epsilon: float = Field(1e-4, gt=0, description="variance added to every observed column")
    steps: int = Field(1, ge=1, description="control steps per replayed window (lambda)")


class Dropo:
    def __init__(self, settings: DropoSettings):
        self._settings = settings

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
        replay = Replay(problem.task, problem.source, data, k, settings.steps)
        if not len(replay.targets):
            raise InvalidInput(
                f"no episode has the {settings.steps} consecutive transitions that one window "
                f"needs; the data are {data!r}"
            )
        diverged = 0

        def loss(x: Vector) -> float:
            nonlocal diverged
            predictions = replay.predict(decode(space, x).quantile(levels))
            if not np.all(np.isfinite(predictions)):
                diverged += 1
                return _WORST
            return -log_likelihood(predictions, replay.targets, settings.epsilon)

        x, best, evaluations = self._search(loss, 2 * len(space), rng, progress)
        if best >= _WORST:
            raise InvalidInput(f"all {evaluations} candidates diverged in simulation")
        return Estimate(
            decode(space, x),
            simulated_steps=evaluations * k * len(replay.targets) * settings.steps,
            diagnostics={
                "loss_per_window": best / len(replay.targets),
                "evaluations": evaluations,
                "diverged_evaluations": diverged,
                "epsilon": settings.epsilon,
            },
        )

    def _search(
        self,
        loss: Callable[[Vector], float],
        dimension: int,
        rng: np.random.Generator,
        progress: Progress,
    ) -> tuple[Vector, float, int]:
        """CMA-ES over [0, 4]^dimension from its middle, restarted until the budget is spent."""
        best_x, best, evaluations = np.full(dimension, 2.0), np.inf, 0
        while evaluations < self._settings.budget:
            es = cma.CMAEvolutionStrategy(
                dimension * [2.0],
                1.0,
                {
                    "bounds": [0, 4],
                    "randn": lambda *shape: rng.standard_normal(shape),
                    "seed": np.nan,  # or pycma would seed NumPy's global generator
                    "verbose": -9,
                },
            )
            while evaluations < self._settings.budget and not es.stop():
                candidates = es.ask()
                losses = [loss(x) for x in candidates]
                es.tell(candidates, losses)
                evaluations += len(candidates)
                if min(losses) < best:
                    best, best_x = min(losses), np.array(candidates[int(np.argmin(losses))])
                progress(evaluations / self._settings.budget, evaluations=evaluations, loss=best)
        return best_x, best, evaluations


def decode(space: ParameterSpace, x: Vector) -> TruncatedGaussian:
    """The distribution at a search point: means, then log-scaled deviations, all in [0, 4]."""
    d, width = len(space), space.high - space.low
    low = np.minimum(1e-5, width / 8 - 1e-5)
    high = width / 4
    std = low * (high / low) ** (x[d:] / space.WIDTH)
    return TruncatedGaussian(space, space.denormalise(x[:d]), std)


def log_likelihood(predictions: Array3, targets: Matrix, epsilon: float) -> float:
    """Sum over windows of log N(target; mean, covariance + epsilon I) of the draws' predictions.

    predictions (k, w, s), targets (w, s).
    """
    k, _, s = predictions.shape
    mean = predictions.mean(axis=0)
    centred = (predictions - mean).transpose(1, 2, 0)  # (w, s, k)
    covariance = centred @ centred.transpose(0, 2, 1) / (k - 1) + epsilon * np.eye(s)
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, (targets - mean)[..., None])[..., 0]
    log_det = 2 * np.sum(np.log(np.diagonal(factor, axis1=1, axis2=2)))
    return float(-0.5 * (np.sum(white**2) + log_det + targets.size * np.log(2 * np.pi)))

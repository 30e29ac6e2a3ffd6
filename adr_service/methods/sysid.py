"""System identification: the point that predicts the recorded transitions best.

Nonlinear least squares on one-step predictions, the baseline that practitioners try first: no
distribution, so the policy is trained on a single simulator. Each Jacobian is one batch of
replays by finite differences (SciPy's trust-region reflective algorithm inside the search
bounds). Residuals are divided by the standard deviation of their column.

The standard deviations that follow from the Jacobian and the residuals are reported as `std` but
not trained on: they are honest only where the model is right.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import qmc

from adr_service.arrays import Matrix, Vector
from adr_service.distributions import Uniform
from adr_service.errors import InvalidInput
from adr_service.methods.base import Estimate, OfflineSettings, Problem
from adr_service.progress import Progress
from adr_service.simulation.replay import Replay
from adr_service.transitions import TransitionDataset

_STEP = 1e-4  # of the finite differences, in [0, 4] coordinates


class SysidSettings(OfflineSettings):
    name: Literal["sysid"] = "sysid"
    starts: int = Field(4, ge=1, le=1000, description="searches, the first from the middle")
    steps: int = Field(1, ge=1, le=10_000, description="control steps per replayed window")
    iterations: int = Field(50, ge=1, le=10_000, description="evaluations per search, at most")

    colour: ClassVar[str] = "#000000"

    def create(self) -> "Sysid":
        return Sysid(self)

    def planned_steps(self, parameters: int, transitions: int) -> int:
        return self.starts * self.iterations * (parameters + 2) * transitions


class Sysid:
    def __init__(self, settings: SysidSettings):
        self._settings = settings

    def fit(
        self,
        problem: Problem,
        data: TransitionDataset,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Estimate:
        settings, space = self._settings, problem.source.space
        d, width = len(space), space.WIDTH
        replay = Replay(problem.task, problem.source, data, d + 1, settings.steps)
        if not len(replay.targets):
            raise InvalidInput(f"no episode has {settings.steps} consecutive transitions: {data!r}")
        residuals = _Residuals(replay, problem)
        others = qmc.LatinHypercube(d, rng=rng).random(settings.starts - 1)
        found: list[OptimizeResult] = []
        for turn, start in enumerate([np.full(d, width / 2), *(width * others)]):
            found.append(
                least_squares(
                    residuals.value,
                    start,
                    jac=residuals.jacobian,  # pyright: ignore[reportArgumentType]
                    bounds=(0, width),
                    xtol=1e-10,
                    ftol=1e-12,
                    gtol=1e-12,
                    max_nfev=settings.iterations,
                )
            )
            progress((turn + 1) / settings.starts, cost=float(found[-1].cost))
        best = min(found, key=lambda result: float(result.cost))
        values = np.clip(space.denormalise(best.x), space.low, space.high)
        return Estimate(
            Uniform.point(space, values),
            simulated_steps=residuals.replayed * len(replay.targets) * settings.steps,
            diagnostics={
                "costs": sorted(float(result.cost) for result in found),
                "mean_squared_error": float(replay.mean_squared_error(values[None])[0]),
                "std": _deviations(best, space.high - space.low, width).tolist(),
                "replays": residuals.replayed,
            },
        )


class _Residuals:
    """Scaled one-step errors of a point in [0, 4]^d, and their derivatives."""

    def __init__(self, replay: Replay, problem: Problem):
        self._replay, self._space = replay, problem.source.space
        deviation = replay.targets.std(axis=0)
        self._scale: Vector = np.where(deviation > 0, deviation, 1.0)
        self.replayed = 0

    def value(self, x: Vector) -> Vector:
        return self._errors(x[None])[0]

    def jacobian(self, x: Vector) -> Matrix:
        """One-sided differences (m, d), towards the inside of the box."""
        steps = np.where(x + _STEP <= self._space.WIDTH, _STEP, -_STEP)
        around = self._errors(np.concatenate([x[None], x + np.diag(steps)]))
        return ((around[1:] - around[0]) / steps[:, None]).T

    def _errors(self, points: Matrix) -> Matrix:
        predictions = self._replay.predict(self._space.denormalise(points))
        self.replayed += len(points)
        if not np.all(np.isfinite(predictions)):
            raise InvalidInput("a replay diverged; the least-squares search cannot go on")
        return ((predictions - self._replay.targets) / self._scale).reshape(len(points), -1)


def _deviations(best: OptimizeResult, ranges: Vector, width: float) -> Vector:
    """Standard deviations (d,) in SI units; infinite where the data do not tell.

    White's estimator: columns and windows may have noise of different size.
    """
    jacobian, residuals = np.asarray(best.jac), np.asarray(best.fun)
    information = jacobian.T @ jacobian
    if np.linalg.cond(information) > 1e15:
        return np.full(len(ranges), np.inf)
    inverse = np.linalg.inv(information)
    covariance = inverse @ ((jacobian.T * residuals**2) @ jacobian) @ inverse
    return np.sqrt(np.diag(covariance)) * ranges / width

"""System identification: the one point that predicts the recorded transitions best.

Nonlinear least squares on predictions of `steps` control steps, which practitioners try first. It
infers no distribution, so the policy is trained on a single simulator. The search is SciPy's
trust-region reflective algorithm (Branch, Coleman, Li: "A Subspace, Interior, and Conjugate
Gradient Method for Large-Scale Bound-Constrained Minimization Problems", SIAM J. Sci. Comput. 21,
1999) inside the search bounds. Finite differences give each Jacobian from one batch of replays.
Residuals are divided by the standard deviation of their column. A step to a point whose replay
diverges is shortened; a search that starts at such a point, or comes next to one, is left out.

Standard deviations that follow from the Jacobian and the residuals (White: "A
Heteroskedasticity-Consistent Covariance Matrix Estimator", Econometrica 48, 1980) are reported as
`std`, null for all where the data leave one open. They assume independent residuals. Noise in
measured states violates that, because one state ends a window and begins the next. The policy of
`sysid` does not train on them, because they are honest only where the model is right.

Two extensions are the ensembles that practitioners train on, and baselines for methods that infer a
spread. `sysid_wide` is uniform within a share of the point, which is next to no width for a
parameter that is estimated near zero. `sysid_laplace` is Laplace's Gaussian under the benchmark's
prior, N(2, I) in [0, 4]. Residuals count as independent, with one deviation for each column, taken
at the point of least squares. The mean is one Gauss-Newton step from that point, which weighs
columns otherwise and has no prior; where the step leaves the search box, it is the mode within.
`mean_squared_error` is that of the point of least squares.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.optimize import OptimizeResult, least_squares, lsq_linear
from scipy.stats import qmc

from adr_service.arrays import Matrix, Vector, column_scales
from adr_service.citations import Paper
from adr_service.distributions import Distribution, Gaussian, Uniform
from adr_service.errors import InvalidInput
from adr_service.methods.base import Estimate, OfflineSettings, Problem, ReplayFrom
from adr_service.parameters import ParameterSpace
from adr_service.progress import Progress
from adr_service.simulation.replay import Replay
from adr_service.transitions import TransitionDataset

_STEP = 1e-4  # of the finite differences, in [0, 4] coordinates
_POINT_TOLERANCE = 1e-10  # a search ends at a smaller relative change of the point
_COST_TOLERANCE = 1e-12  # or of the cost
_GRADIENT_TOLERANCE = 1e-12  # or at a smaller scaled gradient
_MOST_STEPS = 1000  # to a mode within the search box, each along one bound
_OUT_OF_EVALUATIONS = 0  # SciPy's status of a search that `iterations` ended
# Least deviation of residuals, in standard deviations of their column: one-sided differences have
# errors of their step times a curvature, which without noise would look like information
_LEAST_NOISE = 1e-3
_LEAST = 1e-6  # deviation in [0, 4], below which a covariance with others of 1 is rounding
_MOST_CONDITION = 1e15  # of the information matrix, beyond which float64 cannot invert it


class _Diverged(Exception):
    """A search cannot go on, because the replay of a point diverged."""


_SEARCH = Paper(
    "branch1999subspace",
    "A Subspace, Interior, and Conjugate Gradient Method for Large-Scale Bound-Constrained "
    "Minimization Problems",
    "Branch, Mary Ann and Coleman, Thomas F. and Li, Yuying",
    1999,
    journal="SIAM Journal on Scientific Computing",
)
_WHITE = Paper(
    "white1980heteroskedasticity",
    "A Heteroskedasticity-Consistent Covariance Matrix Estimator and a Direct Test for "
    "Heteroskedasticity",
    "White, Halbert",
    1980,
    journal="Econometrica",
)


class _Settings(OfflineSettings):
    papers: ClassVar[tuple[Paper, ...]] = (_SEARCH, _WHITE)

    starts: int = Field(4, ge=1, le=1000, description="searches, the first from the middle")
    steps: int = Field(1, ge=1, le=10_000, description="control steps per replayed window")
    iterations: int = Field(50, ge=1, le=10_000, description="evaluations per search, at most")

    def create(self) -> "Sysid":
        return Sysid(self)

    @property
    def least_transitions(self) -> int:
        return self.steps

    def planned_steps(self, parameters: int, transitions: int) -> int:
        return self.starts * self.iterations * (parameters + 2) * transitions

    def distribution(
        self, space: ParameterSpace, best: OptimizeResult, columns: int
    ) -> Distribution:
        """The distribution to train on.

        `best` is the end of the best search: a point (d,) in [0, 4], its residuals (windows x
        columns,) and their Jacobian, as SciPy returns them.
        """
        return Uniform.point(space, _values(space, best))


class SysidSettings(_Settings):
    name: Literal["sysid"] = "sysid"

    colour: ClassVar[str] = "#000000"


class SysidSmoothedSettings(_Settings):
    """Our extension: replays start from smoothed states."""

    name: Literal["sysid_smoothed"] = "sysid_smoothed"

    replay_from: ClassVar[ReplayFrom] = "smoothed"
    label: ClassVar[str] = "sysid, smoothed states"
    colour: ClassVar[str] = "#525252"


class SysidWideSettings(_Settings):
    """Our extension: a box around the point."""

    name: Literal["sysid_wide"] = "sysid_wide"
    width: float = Field(
        0.1,
        gt=0,
        lt=1,
        description="half of the box, as a share of the point; next to none "
        "for a parameter that is estimated near 0",
    )

    label: ClassVar[str] = "sysid, box around it"
    colour: ClassVar[str] = "#8C8C8C"

    def distribution(
        self, space: ParameterSpace, best: OptimizeResult, columns: int
    ) -> Distribution:
        values = _values(space, best)
        low = np.maximum(values - self.width * np.abs(values), space.feasible_low)
        return Uniform(space, low, values + self.width * np.abs(values))


class SysidLaplaceSettings(_Settings):
    """Our extension: the Gaussian of Laplace's method."""

    name: Literal["sysid_laplace"] = "sysid_laplace"

    label: ClassVar[str] = "sysid, Laplace"
    colour: ClassVar[str] = "#44546A"

    def distribution(
        self, space: ParameterSpace, best: OptimizeResult, columns: int
    ) -> Distribution:
        residuals = np.asarray(best.fun).reshape(-1, columns)
        deviations = np.maximum(np.sqrt(np.mean(residuals**2, axis=0)), _LEAST_NOISE)
        weights = np.tile(1 / deviations, len(residuals))
        # by singular values: squares of those without noise would drown the prior in rounding
        rows = np.vstack([np.asarray(best.jac) * weights[:, None], np.eye(len(space))])
        left = np.concatenate([residuals.ravel() * weights, best.x - space.WIDTH / 2])
        shares, information, axes = np.linalg.svd(rows, full_matrices=False)
        mode = best.x - axes.T @ ((shares.T @ left) / information)
        if np.any((mode < 0) | (mode > space.WIDTH)):
            # not coordinate by coordinate, because parameters depend on each other
            mode = lsq_linear(
                rows, rows @ best.x - left, (0, space.WIDTH), method="bvls", max_iter=_MOST_STEPS
            ).x
        variances = np.maximum(1 / information, _LEAST) ** 2
        return Gaussian(space, mode, (axes.T * variances) @ axes)


class Sysid:
    def __init__(self, settings: _Settings):
        self._settings = settings

    def fit(
        self,
        problem: Problem,
        data: TransitionDataset,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Estimate:
        steps, space = self._settings.steps, problem.source.space
        # a Jacobian replays a point and one neighbour per parameter
        replay = Replay(problem.task, problem.source, data, len(space) + 1, steps)
        residuals = _Residuals(replay, problem)
        ends = self._search(residuals, len(space), rng, progress)
        best = min(ends, key=lambda end: float(end.cost))
        unconverged = sum(end.status == _OUT_OF_EVALUATIONS for end in ends)
        left_out = self._settings.starts - len(ends)  # because replays diverged
        values = _values(space, best)
        ranges = (space.high - space.low) / space.WIDTH
        return Estimate(
            self._settings.distribution(space, best, replay.targets.shape[1]),
            simulated_steps=residuals.replayed * len(replay.targets) * steps,
            diagnostics={
                "costs": sorted(float(end.cost) for end in ends),
                "mean_squared_error": float(replay.mean_squared_error(values[None])[0]),
                "std": _finite(_deviations(best) * ranges),
                "replays": residuals.replayed,
                # not where there are none, so that results keep their bytes
                **({"diverged_replays": residuals.diverged} if residuals.diverged else {}),
                **({"unconverged_searches": unconverged} if unconverged else {}),
                **({"left_out_searches": left_out} if left_out else {}),
            },
        )

    def _search(
        self, residuals: "_Residuals", d: int, rng: np.random.Generator, progress: Progress
    ) -> list[OptimizeResult]:
        """The ends of the searches, from the middle of the box and from a Latin hypercube.

        Raises InvalidInput if the replay diverged in all of them.
        """
        others = qmc.LatinHypercube(d, rng=rng).random(self._settings.starts - 1)
        starts = ParameterSpace.WIDTH * np.concatenate([np.full((1, d), 0.5), others])
        ends: list[OptimizeResult] = []
        lost = ""
        for number, start in enumerate(starts, 1):
            try:
                ends.append(self._search_from(start, residuals))
                progress(number / len(starts), cost=float(ends[-1].cost))
            except _Diverged as error:
                lost = str(error)
        if not ends:
            raise InvalidInput(f"{lost}, and none of {len(starts)} searches could go on")
        return ends

    def _search_from(self, start: Vector, residuals: "_Residuals") -> OptimizeResult:
        """The end of min 1/2 ||r(x)||^2 from a start (d,), by Branch, Coleman and Li.

        Raises _Diverged at a point without a Jacobian; others that diverge only shorten steps.
        """

        def value(x: Vector) -> Vector:
            found = residuals.value(x)
            if np.array_equal(x, start):
                residuals.check(found, x)
            return found

        return least_squares(
            value,
            start,
            jac=residuals.jacobian,  # pyright: ignore[reportArgumentType]
            bounds=(0, ParameterSpace.WIDTH),
            xtol=_POINT_TOLERANCE,
            ftol=_COST_TOLERANCE,
            gtol=_GRADIENT_TOLERANCE,
            max_nfev=self._settings.iterations,
        )


class _Residuals:
    """Scaled errors of a point in [0, 4]^d, and their derivatives."""

    def __init__(self, replay: Replay, problem: Problem):
        self._replay, self._space = replay, problem.source.space
        self._scale = column_scales(replay.targets)
        self.replayed = 0  # points
        self.diverged = 0  # of these

    def value(self, x: Vector) -> Vector:
        """The residuals r(x), (m,), of all windows and columns; not finite where it diverged."""
        return self._errors(x[None])[0]

    def jacobian(self, x: Vector) -> Matrix:
        """The Jacobian (m, d), by one-sided differences towards the inside of the box."""
        steps = np.where(x + _STEP <= self._space.WIDTH, _STEP, -_STEP)
        points = np.concatenate([x[None], x + np.diag(steps)])
        around = self._errors(points)
        for errors, point in zip(around, points, strict=True):
            self.check(errors, point)
        return ((around[1:] - around[0]) / steps[:, None]).T

    def check(self, errors: Vector, x: Vector) -> None:
        """Raise _Diverged if the residuals (m,) of a point (d,) are not finite."""
        if not np.isfinite(errors).all():
            pairs = zip(self._space.names, self._space.denormalise(x[None])[0], strict=True)
            raise _Diverged(f"a replay diverged at {', '.join(f'{n} {v:.4g}' for n, v in pairs)}")

    def _errors(self, points: Matrix) -> Matrix:
        predictions = self._replay.predict(self._space.denormalise(points))
        self.replayed += len(points)
        self.diverged += int(np.sum(~np.isfinite(predictions).all(axis=(1, 2))))
        return ((predictions - self._replay.targets) / self._scale).reshape(len(points), -1)


def _values(space: ParameterSpace, best: OptimizeResult) -> Vector:
    """The point (d,) in SI units."""
    return np.clip(space.denormalise(best.x), space.low, space.high)


def _finite(values: Vector) -> list[float | None]:
    """Numbers for JSON, which has none for infinity."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _deviations(best: OptimizeResult) -> Vector:
    """Standard deviations (d,) in [0, 4]; all infinite if the data leave a parameter open.

    White's estimator, (J'J)^-1 J' diag(r^2) J (J'J)^-1: noise may differ between columns and
    windows.
    """
    jacobian, residuals = np.asarray(best.jac), np.asarray(best.fun)
    information = jacobian.T @ jacobian
    if np.linalg.cond(information) > _MOST_CONDITION:
        return np.full(jacobian.shape[1], np.inf)
    inverse = np.linalg.inv(information)
    covariance = inverse @ ((jacobian.T * residuals**2) @ jacobian) @ inverse
    return np.sqrt(np.diag(covariance))

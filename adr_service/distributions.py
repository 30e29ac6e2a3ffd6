"""Distributions over a parameter space: methods infer them, policies are trained on them.

    belief = Gaussian.prior(space)              # the paper's N(2, I) in [0, 4]
    draws = belief.sample(12, rng)       # .values (12, d) in SI units, .adjusted

Draws are always feasible. `Draws.adjusted` counts those that were moved to make them so.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.errors import InfeasibleDistribution, InvalidInput, UnknownName
from adr_service.parameters import ParameterSpace


@dataclass(frozen=True)
class Draws:
    """Samples of a distribution, and how many of them were moved onto a bound."""

    values: Matrix  # (n, d), SI units, feasible
    adjusted: int  # rows with at least one coordinate moved onto a bound


class Distribution(Protocol):
    """A distribution over the parameters of a space, in SI units unless stated otherwise."""

    @property
    def space(self) -> ParameterSpace: ...
    @property
    def mean(self) -> Vector: ...  # (d,) SI; of the untruncated distribution
    @property
    def std(self) -> Vector: ...  # (d,) SI; marginal, of the untruncated distribution
    def sample(self, n: int, rng: np.random.Generator) -> Draws: ...
    def log_prob(self, values: Matrix) -> Vector: ...  # (n, d) -> (n,)
    def to_json(self) -> dict[str, Any]: ...


@dataclass(frozen=True)
class Uniform:
    """Independent uniform intervals; an interval of zero width is a known value."""

    space: ParameterSpace
    low: Vector  # (d,)
    high: Vector  # (d,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "low", _vector(self.space, self.low, "low"))
        object.__setattr__(self, "high", _vector(self.space, self.high, "high"))
        if np.any(self.low > self.high):
            raise InvalidInput(f"uniform bounds need low <= high; given {self.low}, {self.high}")
        if np.any(self.low < self.space.feasible_low):
            raise InfeasibleDistribution(
                f"uniform low {self.low} is below the feasible {self.space.feasible_low}"
            )

    @classmethod
    def point(cls, space: ParameterSpace, values: Vector) -> "Uniform":
        """Certainty: every draw equals `values`."""
        return cls(space, values, values)

    @property
    def mean(self) -> Vector:
        return (self.low + self.high) / 2

    @property
    def std(self) -> Vector:
        return (self.high - self.low) / np.sqrt(12)  # of a uniform interval

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        return Draws(frozen(rng.uniform(self.low, self.high, (n, len(self.space)))), 0)

    def log_prob(self, values: Matrix) -> Vector:
        inside = np.all((values >= self.low) & (values <= self.high), axis=1)
        width = self.high - self.low
        with np.errstate(divide="ignore"):  # a point has infinite density at its values
            return np.where(inside, -np.sum(np.log(width)), -np.inf)

    def to_json(self) -> dict[str, Any]:
        return {"kind": "uniform", "low": self.low.tolist(), "high": self.high.tolist()}


@dataclass(frozen=True)
class Gaussian:
    """A full Gaussian over the coordinates in [0, 4], its draws clipped to the search box.

    The benchmark clips too (random-envs `fullgaussian`); `Draws.adjusted` counts clipped draws.
    """

    space: ParameterSpace
    location: Vector  # (d,) in [0, 4] coordinates
    covariance: Matrix  # (d, d) in [0, 4] coordinates

    def __post_init__(self) -> None:
        object.__setattr__(self, "location", _vector(self.space, self.location, "location"))
        object.__setattr__(self, "covariance", frozen(self.covariance))
        d = len(self.space)
        if self.covariance.shape != (d, d) or not np.all(np.isfinite(self.covariance)):
            raise InvalidInput(f"covariance must be finite and ({d}, {d}): {self.covariance}")
        if np.linalg.eigvalsh(self.covariance)[0] < 0:
            raise InvalidInput(f"covariance must be positive semi-definite: {self.covariance}")

    @classmethod
    def prior(cls, space: ParameterSpace) -> "Gaussian":
        """The prior N(2, I) in [0, 4] coordinates (Tiboni et al., Sec. 3.2)."""
        d = len(space)
        return cls(space, np.full(d, space.WIDTH / 2), np.eye(d))

    @property
    def mean(self) -> Vector:
        return self.space.denormalise(self.location)

    @property
    def std(self) -> Vector:
        return np.sqrt(np.diag(self.covariance)) * self._scale

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        raw = rng.multivariate_normal(self.location, self.covariance, n, method="eigh")
        inside = np.clip(raw, 0.0, self.space.WIDTH)
        adjusted = int(np.sum(np.any(raw != inside, axis=1)))
        return Draws(frozen(self.space.denormalise(inside)), adjusted)

    def log_prob(self, values: Matrix) -> Vector:
        """Log density of the unclipped Gaussian, per SI unit."""
        from scipy import stats

        x, mean = self.space.normalise(values), self.location
        cov: Any = self.covariance  # annotated as a number in SciPy
        density = np.atleast_1d(stats.multivariate_normal.logpdf(x, mean, cov, allow_singular=True))
        # p(value) = p(x) |dx / dvalue|
        return density - np.sum(np.log(self._scale))

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": "gaussian",
            "location": self.location.tolist(),
            "covariance": self.covariance.tolist(),
        }

    @property
    def _scale(self) -> Vector:
        """SI units per normalised coordinate, (d,)."""
        return (self.space.high - self.space.low) / self.space.WIDTH


@dataclass(frozen=True)
class TruncatedGaussian:
    """Independent normals cut at two standard deviations and at the feasible bound.

    DROPO (Tiboni et al., arXiv 2201.08434), Sec. IV; random-envs `truncnorm`. Random-envs redraws
    infeasible values three times and then clamps them; here the inverse of the distribution
    function excludes them, so no draw is adjusted.
    """

    space: ParameterSpace
    mean: Vector  # (d,)
    std: Vector  # (d,), > 0
    CUT = 2.0  # standard deviations

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", _vector(self.space, self.mean, "mean"))
        object.__setattr__(self, "std", _vector(self.space, self.std, "std"))
        if np.any(self.std <= 0):
            raise InvalidInput(f"standard deviations must be positive; given {self.std}")
        if np.any(self.mean + self.CUT * self.std <= self.space.feasible_low):
            raise InfeasibleDistribution(
                f"no draw of mean {self.mean}, std {self.std} within {self.CUT} std reaches "
                f"the feasible {self.space.feasible_low}"
            )

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        return Draws(frozen(self.quantile(rng.random((n, len(self.space))))), 0)

    def quantile(self, levels: Matrix) -> Matrix:
        """Values (n, d) at probabilities `levels` (n, d) in [0, 1), as common random numbers."""
        from scipy import stats

        low, high = self._limits
        return self.mean + self.std * stats.truncnorm.ppf(levels, low, high)

    def log_prob(self, values: Matrix) -> Vector:
        from scipy import stats

        low, high = self._limits
        return np.sum(stats.truncnorm.logpdf(values, low, high, self.mean, self.std), axis=1)

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": "truncated_gaussian",
            "mean": self.mean.tolist(),
            "std": self.std.tolist(),
        }

    @property
    def _limits(self) -> tuple[Vector, Vector]:
        """Lower and upper cut, (d,) each, in standard deviations from the mean."""
        feasible = (self.space.feasible_low - self.mean) / self.std
        return np.maximum(-self.CUT, feasible), np.full(len(self.space), self.CUT)


def normalised_std(distribution: Distribution) -> Vector:
    """Standard deviations (d,) in [0, 4] coordinates."""
    space = distribution.space
    return distribution.std / (space.high - space.low) * space.WIDTH


def at_resolution(distribution: Distribution, resolution: float) -> Distribution:
    """A point on a grid, where every deviation is below the grid's width; else the distribution.

    In [0, 4] coordinates. The point lies in the search box, as the draws of a Gaussian do.
    """
    space = distribution.space
    if np.any(normalised_std(distribution) >= resolution):
        return distribution
    nearest = np.round(space.normalise(distribution.mean) / resolution) * resolution
    return Uniform.point(space, space.denormalise(np.clip(nearest, 0.0, space.WIDTH)))


def distribution_from_json(space: ParameterSpace, document: dict[str, Any]) -> Distribution:
    """The distribution of a document that `to_json` made."""
    kind = str(document.get("kind"))
    if kind not in KINDS:
        raise UnknownName("distribution kind", kind, KINDS)
    create, fields = KINDS[kind]
    if missing := [name for name in fields if name not in document]:
        raise InvalidInput(f"a {kind} distribution needs {', '.join(fields)}; not given: {missing}")
    return create(space, *(document[name] for name in fields))


KINDS: dict[str, tuple[Callable[..., Distribution], tuple[str, str]]] = {
    "uniform": (Uniform, ("low", "high")),
    "gaussian": (Gaussian, ("location", "covariance")),
    "truncated_gaussian": (TruncatedGaussian, ("mean", "std")),
}


def _vector(space: ParameterSpace, values: Any, name: str) -> Vector:
    vector = frozen(values)
    if vector.shape != (len(space),) or not np.all(np.isfinite(vector)):
        raise InvalidInput(
            f"{name} must hold {len(space)} finite values, one for each of "
            f"{', '.join(space.names)}; given {vector.tolist()}"
        )
    return vector

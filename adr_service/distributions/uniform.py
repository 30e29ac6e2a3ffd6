"""Uniform boxes, and points: what UDR and BayRn train on."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.distributions.base import Distribution, Draws, finite_vector, normalised_std
from adr_service.errors import InfeasibleDistribution, InvalidInput
from adr_service.parameters import ParameterSpace


@dataclass(frozen=True)
class Uniform:
    """Independent uniform intervals; an interval of zero width is a known value."""

    space: ParameterSpace
    low: Vector  # (d,)
    high: Vector  # (d,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "low", finite_vector(self.space, self.low, "low"))
        object.__setattr__(self, "high", finite_vector(self.space, self.high, "high"))
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


def at_resolution(distribution: Distribution, resolution: float) -> Distribution:
    """The nearest grid point if all deviations are below `resolution`; else the distribution.

    `resolution` is the grid's width in [0, 4] coordinates. Boxes of any width are kept, because
    their width is the method's choice. The result lies in the search box, as a Gaussian's draws do;
    a point that was outside moves no further out.
    """
    space = distribution.space
    is_box = isinstance(distribution, Uniform) and np.any(distribution.low < distribution.high)
    if is_box or np.any(normalised_std(distribution) >= resolution):
        return distribution
    x = space.normalise(distribution.mean)
    least, most = np.zeros(len(space)), np.full(len(space), space.WIDTH)
    if isinstance(distribution, Uniform):
        least, most = np.minimum(least, x), np.maximum(most, x)
    nearest = np.clip(np.round(x / resolution) * resolution, least, most)
    # values at the feasible bound may come back from the coordinates a rounding error below it
    return Uniform.point(space, np.maximum(space.denormalise(nearest), space.feasible_low))

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
    """A point on a grid, where every deviation is below the grid's width; else the distribution.

    In [0, 4] coordinates. The point lies in the search box, as the draws of a Gaussian do.
    """
    space = distribution.space
    if np.any(normalised_std(distribution) >= resolution):
        return distribution
    nearest = np.round(space.normalise(distribution.mean) / resolution) * resolution
    return Uniform.point(space, space.denormalise(np.clip(nearest, 0.0, space.WIDTH)))

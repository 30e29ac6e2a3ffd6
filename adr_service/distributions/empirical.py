"""Weighted samples: posteriors that no formula has, and the worst cases of EPOpt."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.distributions.base import WEIGHTS_TOLERANCE, Draws, array_of
from adr_service.errors import InfeasibleDistribution, InvalidInput
from adr_service.parameters import ParameterSpace


@dataclass(frozen=True)
class Empirical:
    """Points with weights; every draw is one of the points."""

    space: ParameterSpace
    points: Matrix  # (n, d), SI units, feasible
    weights: Vector  # (n,), >= 0, of sum 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", array_of("points", self.points))
        object.__setattr__(self, "weights", array_of("weights", self.weights))
        n, d = self.weights.size, len(self.space)
        if n == 0 or (self.weights.shape, self.points.shape) != ((n,), (n, d)):
            raise InvalidInput(
                f"an empirical distribution needs points (n, {d}) and weights (n,); "
                f"given {self.points.shape} and {self.weights.shape}"
            )
        if not np.all(np.isfinite(self.points)):
            raise InvalidInput(f"points must be finite; given {self.points}")
        # NaN is not accepted, for it compares with nothing
        if not (np.all(self.weights >= 0) and abs(np.sum(self.weights) - 1) <= WEIGHTS_TOLERANCE):
            raise InvalidInput(f"weights must be 0 or more, of sum 1; given {self.weights}")
        if np.any(self.points < self.space.feasible_low):
            raise InfeasibleDistribution(
                f"a point lies below the feasible {self.space.feasible_low}; the least values are "
                f"{self.points.min(axis=0)}"
            )

    @classmethod
    def equal(cls, space: ParameterSpace, points: Matrix) -> "Empirical":
        """Points (n, d) that all count the same."""
        return cls(space, points, np.full(len(points), 1 / len(points)))

    @property
    def mean(self) -> Vector:
        return self.weights @ self.points

    @property
    def std(self) -> Vector:
        return np.sqrt(self.weights @ (self.points - self.mean) ** 2)

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        return Draws(frozen(self.points[rng.choice(len(self.weights), n, p=self.weights)]), 0)

    def log_prob(self, values: Matrix) -> Vector:
        """Infinite at a point with weight, as a density is there, and -inf between the points."""
        held = self.points[self.weights > 0]
        is_point = np.any(np.all(values[:, None] == held, axis=2), axis=1)
        return np.where(is_point, np.inf, -np.inf)

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": "empirical",
            "points": self.points.tolist(),
            "weights": self.weights.tolist(),
        }

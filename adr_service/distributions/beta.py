"""Independent Beta distributions over the search box: what DORAEMON trains on."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.distributions.base import Draws, finite_vector
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace


@dataclass(frozen=True)
class Beta:
    """One Beta per parameter, stretched over its search bounds; both shapes 1 are the whole box."""

    space: ParameterSpace
    alpha: Vector  # (d,), > 0
    beta: Vector  # (d,), > 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "alpha", finite_vector(self.space, self.alpha, "alpha"))
        object.__setattr__(self, "beta", finite_vector(self.space, self.beta, "beta"))
        if np.any(self.alpha <= 0) or np.any(self.beta <= 0):
            raise InvalidInput(f"shapes must be positive; given {self.alpha}, {self.beta}")

    @property
    def mean(self) -> Vector:
        share = self.alpha / (self.alpha + self.beta)
        return self.space.low + share * self._width

    @property
    def std(self) -> Vector:
        total = self.alpha + self.beta
        return self._width * np.sqrt(self.alpha * self.beta / (total + 1)) / total

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        share = rng.beta(self.alpha, self.beta, (n, len(self.space)))
        return Draws(frozen(self.space.low + share * self._width), 0)

    def log_prob(self, values: Matrix) -> Vector:
        from scipy import stats

        low, width = self.space.low, self._width
        return np.sum(stats.beta.logpdf(values, self.alpha, self.beta, low, width), axis=1)

    def to_json(self) -> dict[str, Any]:
        return {"kind": "beta", "alpha": self.alpha.tolist(), "beta": self.beta.tolist()}

    @property
    def _width(self) -> Vector:
        return self.space.high - self.space.low

"""Independent truncated normals: what DROPO infers."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.distributions.base import Draws, finite_vector
from adr_service.errors import InfeasibleDistribution, InvalidInput
from adr_service.parameters import ParameterSpace


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
        object.__setattr__(self, "mean", finite_vector(self.space, self.mean, "mean"))
        object.__setattr__(self, "std", finite_vector(self.space, self.std, "std"))
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

"""The interface of distributions, and what all of them share."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.errors import InvalidInput
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


def normalised_std(distribution: Distribution) -> Vector:
    """Standard deviations (d,) in [0, 4] coordinates."""
    space = distribution.space
    return distribution.std / (space.high - space.low) * space.WIDTH


def finite_vector(space: ParameterSpace, values: Any, name: str) -> Vector:
    """The values (d,) as a read-only array. Raises InvalidInput unless all are finite."""
    vector = frozen(values)
    if vector.shape != (len(space),) or not np.all(np.isfinite(vector)):
        raise InvalidInput(
            f"{name} must hold {len(space)} finite values, one for each of "
            f"{', '.join(space.names)}; given {vector.tolist()}"
        )
    return vector

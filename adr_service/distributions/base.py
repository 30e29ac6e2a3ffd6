"""The interface of distributions, and what all of them share."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace

WEIGHTS_TOLERANCE = 1e-8  # of the sum of weights, NumPy's own


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


def check_space(name: str, distribution: Distribution, space: ParameterSpace) -> None:
    """Raise InvalidInput unless a distribution is over this space; `name` is its subject.

    The JSON of a distribution has no names of parameters: it is read in the order of the space.
    """
    if distribution.space != space:
        raise InvalidInput(
            f"{name} is over {', '.join(distribution.space.names)}; accepted is one over the "
            f"source's own space: {', '.join(space.names)}, in this order, with the same bounds"
        )


def array_of(name: str, values: Any) -> Matrix:
    """The values as a read-only array. Raises InvalidInput unless they are numbers in a grid."""
    try:
        if np.asarray(values).dtype.kind not in "iuf":
            raise TypeError(f"given {values!r}")
        return frozen(values)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"{name} must be numbers, in rows of one length: {error}") from error


def finite_vector(space: ParameterSpace, values: Any, name: str) -> Vector:
    """The values (d,) as a read-only array. Raises InvalidInput unless all are finite."""
    vector = array_of(name, values)
    if vector.shape != (len(space),) or not np.all(np.isfinite(vector)):
        raise InvalidInput(
            f"{name} must hold {len(space)} finite values, one for each of "
            f"{', '.join(space.names)}; given {vector.tolist()}"
        )
    return vector

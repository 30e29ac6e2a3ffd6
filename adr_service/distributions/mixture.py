"""Mixtures of Gaussians: posteriors with several modes, or bent ones."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from adr_service.arrays import Array3, Matrix, Vector, frozen
from adr_service.distributions.base import WEIGHTS_TOLERANCE, Draws, array_of
from adr_service.distributions.gaussian import Gaussian
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace


@dataclass(frozen=True)
class Mixture:
    """A weighted sum of Gaussians over the coordinates in [0, 4].

    Draws are clipped to the search box and counted, as a Gaussian's are.
    """

    space: ParameterSpace
    weights: Vector  # (k,), > 0, of sum 1
    locations: Matrix  # (k, d) in [0, 4] coordinates
    covariances: Array3  # (k, d, d) in [0, 4] coordinates
    components: tuple[Gaussian, ...] = field(init=False, repr=False)  # without their weights

    def __post_init__(self) -> None:
        for name in ("weights", "locations", "covariances"):
            object.__setattr__(self, name, array_of(name, getattr(self, name)))
        k, d = self.weights.size, len(self.space)
        shapes = [a.shape for a in (self.weights, self.locations, self.covariances)]
        if k == 0 or shapes != [(k,), (k, d), (k, d, d)]:
            raise InvalidInput(
                f"a mixture needs weights (k,), locations (k, {d}) and covariances (k, {d}, {d}); "
                f"given {', '.join(map(str, shapes))}"
            )
        # NaN is not accepted, for it compares with nothing
        if not (np.all(self.weights > 0) and abs(np.sum(self.weights) - 1) <= WEIGHTS_TOLERANCE):
            raise InvalidInput(f"weights must be positive, of sum 1; given {self.weights}")
        pairs = zip(self.locations, self.covariances, strict=True)
        components = tuple(Gaussian(self.space, *pair) for pair in pairs)
        object.__setattr__(self, "components", components)

    @property
    def mean(self) -> Vector:
        return self.space.denormalise(self.weights @ self.locations)

    @property
    def std(self) -> Vector:
        spread = self.locations - self.weights @ self.locations  # of the components, (k, d)
        within = np.diagonal(self.covariances, axis1=1, axis2=2)  # (k, d)
        return np.sqrt(self.weights @ (within + spread**2)) * self.space.scale

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        chosen = rng.choice(len(self.weights), n, p=self.weights)
        values, adjusted = np.empty((n, len(self.space))), 0
        for i, component in enumerate(self.components):
            rows = np.flatnonzero(chosen == i)
            draws = component.sample(len(rows), rng)
            values[rows], adjusted = draws.values, adjusted + draws.adjusted
        return Draws(frozen(values), adjusted)

    def log_prob(self, values: Matrix) -> Vector:
        """Log density of the unclipped mixture, per SI unit."""
        each = [component.log_prob(values) for component in self.components]
        return np.logaddexp.reduce(np.log(self.weights)[:, None] + np.array(each), axis=0)

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": "mixture",
            "weights": self.weights.tolist(),
            "locations": self.locations.tolist(),
            "covariances": self.covariances.tolist(),
        }

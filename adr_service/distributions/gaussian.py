"""Gaussians with a full covariance: the prior, and what SimOpt and DROID infer."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.distributions.base import Draws, array_of, finite_vector
from adr_service.errors import InvalidInput
from adr_service.parameters import ParameterSpace

_ASYMMETRY = 1e-6  # of the largest entry, which rounding may leave
_ROUNDING = 1e-12  # of the largest variance, by which a variance of 0 may be computed as negative


@dataclass(frozen=True)
class Gaussian:
    """A full Gaussian over the coordinates in [0, 4], its draws clipped to the search box.

    The benchmark clips too (random-envs `fullgaussian`); `Draws.adjusted` counts clipped draws.
    """

    space: ParameterSpace
    location: Vector  # (d,) in [0, 4] coordinates
    covariance: Matrix  # (d, d) in [0, 4] coordinates

    def __post_init__(self) -> None:
        object.__setattr__(self, "location", finite_vector(self.space, self.location, "location"))
        object.__setattr__(self, "covariance", array_of("covariance", self.covariance))
        d = len(self.space)
        if self.covariance.shape != (d, d) or not np.all(np.isfinite(self.covariance)):
            raise InvalidInput(f"covariance must be finite and ({d}, {d}): {self.covariance}")
        lopsided = np.abs(self.covariance - self.covariance.T).max()
        if lopsided > _ASYMMETRY * np.abs(self.covariance).max():
            raise InvalidInput(f"covariance must be symmetric: {self.covariance}")
        variances = np.linalg.eigvalsh(self.covariance)  # along the axes, in ascending order
        if variances[0] < -_ROUNDING * variances[-1]:
            raise InvalidInput(f"covariance must be positive semi-definite: {self.covariance}")

    @classmethod
    def prior(cls, space: ParameterSpace) -> "Gaussian":
        """The prior N(2, I) in [0, 4] coordinates (Tiboni et al., Sec. 3.4)."""
        d = len(space)
        return cls(space, np.full(d, space.WIDTH / 2), np.eye(d))

    @property
    def mean(self) -> Vector:
        return self.space.denormalise(self.location)

    @property
    def std(self) -> Vector:
        return np.sqrt(np.diag(self.covariance)) * self.space.scale

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        raw = rng.multivariate_normal(self.location, self.covariance, n, method="eigh")
        inside = np.clip(raw, 0.0, self.space.WIDTH)
        adjusted = int(np.sum(np.any(raw != inside, axis=1)))
        return Draws(frozen(self.space.denormalise(inside)), adjusted)

    def log_prob(self, values: Matrix) -> Vector:
        """Log density of the unclipped Gaussian, per SI unit.

        A singular one has SciPy's: a density on the plane of its draws, and none elsewhere. A point
        has an infinite one at itself.
        """
        from scipy import linalg

        x = self.space.normalise(values)
        variances, axes = linalg.eigh(self.covariance)
        if not variances.any():
            density = np.where(np.all(x == self.location, axis=1), np.inf, -np.inf)
        elif variances[0] > len(variances) * np.finfo(np.float64).eps * variances[-1]:
            white = (x - self.location) @ (axes * np.sqrt(1 / variances))
            log_det = np.sum(np.log(variances))
            squares = np.sum(white**2, axis=1)
            density = -0.5 * (len(variances) * np.log(2 * np.pi) + log_det + squares)
        else:
            density = _singular_log_prob(x, self.location, self.covariance)
        # p(value) = p(x) |dx / dvalue|
        return density - np.sum(np.log(self.space.scale))

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": "gaussian",
            "location": self.location.tolist(),
            "covariance": self.covariance.tolist(),
        }


def _singular_log_prob(x: Matrix, mean: Vector, covariance: Any) -> Vector:
    """SciPy's log density (n,), which takes variances below 2e-10 of the largest for 0."""
    from scipy import stats

    # the covariance is annotated as a number in SciPy
    density = stats.multivariate_normal.logpdf(x, mean, covariance, allow_singular=True)
    return np.atleast_1d(density)

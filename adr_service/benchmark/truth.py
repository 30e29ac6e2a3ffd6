"""The hidden truth of simulated targets, for reports alone."""

import numpy as np
from scipy.stats import norm

from adr_service.arrays import Vector
from adr_service.distributions import Distribution, Empirical, TruncatedGaussian, Uniform
from adr_service.randomness import stream
from adr_service.tasks.catalogue import hidden_of, variant_of

_DRAWS = 500  # for the energy score


def estimation_error(task: str, variant: str, mean: Vector) -> float:
    """Root-mean-square distance of an estimate's mean (d,) from the truth, in [0, 4] coordinates.

    Over the parameters of the variant's source space.
    """
    pair = variant_of(task, variant)
    space, truth = pair.source.space, pair.truth
    return float(np.sqrt(np.mean((space.normalise(mean) - space.normalise(truth)) ** 2)))


def true_values(task: str, variant: str) -> dict[str, float]:
    """The hidden truth by parameter name, in SI units."""
    hidden = hidden_of(task, variant)
    return dict(zip(hidden.source.space.names, hidden.values.tolist(), strict=True))


def log_score(task: str, variant: str, distribution: Distribution) -> float | None:
    """Log density of the truth [nat, per SI unit]; None for boxes, points and samples.

    DROPO's own density is 0 beyond two deviations, so that of the Gaussian with its mean and
    deviations is taken.
    """
    truth = variant_of(task, variant).truth
    if isinstance(distribution, Uniform | Empirical):
        return None
    if isinstance(distribution, TruncatedGaussian):
        return float(norm.logpdf(truth, distribution.mean, distribution.std).sum())
    return float(distribution.log_prob(truth[None])[0])


def energy_score(task: str, variant: str, distribution: Distribution) -> float:
    """The energy score of a belief at the truth, in the unit of `estimation_error`.

    Mean distance of draws from the truth less half their mean distance from each other (Gneiting
    and Raftery 2007, eq. 21): small where a belief is near the truth and no wider or narrower than
    its error. A point's is its distance from the truth.
    """
    pair = variant_of(task, variant)
    space, rng = pair.source.space, stream("energy score")
    draws = [space.normalise(distribution.sample(_DRAWS, rng).values) for _ in range(2)]
    size = np.sqrt(len(space))
    from_truth = np.linalg.norm(draws[0] - space.normalise(pair.truth), axis=1).mean()
    apart = np.linalg.norm(draws[0] - draws[1], axis=1).mean()
    return float((from_truth - apart / 2) / size)

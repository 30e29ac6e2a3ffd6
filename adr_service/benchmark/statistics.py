"""How sure a mean is: intervals over seeds, policies and episodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.errors import InvalidInput

_RESAMPLES = 2000
_LEVEL = 0.95
_CHUNK = 1_000_000  # returns drawn at once


@dataclass(frozen=True)
class Interval:
    """A mean with its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float


def mean_interval(seeds: Sequence[Matrix], rng: np.random.Generator) -> Interval:
    """Mean over seeds of their mean returns, with its interval.

    Each seed is a (policies, episodes) array. The bootstrap resamples seeds, then policies,
    then episodes, so that the interval covers repeating the whole experiment. With few seeds
    it is too short (three seeds have ten distinct resamples): report their number with it.
    """
    if not seeds or any(returns.size == 0 for returns in seeds):
        raise InvalidInput("an interval needs at least one return of at least one seed")
    count = len(seeds)
    means = np.empty((_RESAMPLES, count))
    # seed by seed and chunk by chunk, because all draws at once may not fit into memory
    for place in range(count):
        chosen = rng.integers(count, size=_RESAMPLES)
        for index, returns in enumerate(seeds):
            rows = np.flatnonzero(chosen == index)
            for part in np.array_split(rows, 1 + len(rows) * returns.size // _CHUNK):
                means[part, place] = _resampled_means(returns, len(part), rng)
    tail = 100 * (1 - _LEVEL) / 2
    low, high = np.percentile(means.mean(axis=1), [tail, 100 - tail])
    mean = float(np.mean([float(np.mean(returns)) for returns in seeds]))
    return Interval(mean, float(low), float(high))


def _resampled_means(returns: Matrix, count: int, rng: np.random.Generator) -> Vector:
    """Means of `count` resamples of policies and their episodes, (count,)."""
    policies, episodes = returns.shape
    rows = rng.integers(policies, size=(count, policies, 1))
    columns = rng.integers(episodes, size=(count, policies, episodes))
    return returns[rows, columns].mean(axis=(1, 2))

"""How sure a mean is: intervals over seeds, policies and episodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.errors import InvalidInput

_RESAMPLES = 2000
_LEVEL = 0.95


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
    means: Vector = np.array([float(np.mean(returns)) for returns in seeds])
    resampled = np.empty(_RESAMPLES)
    for i in range(_RESAMPLES):
        chosen = rng.integers(len(seeds), size=len(seeds))
        resampled[i] = np.mean([_resampled_mean(seeds[k], rng) for k in chosen])
    tail = 100 * (1 - _LEVEL) / 2
    low, high = np.percentile(resampled, [tail, 100 - tail])
    return Interval(float(np.mean(means)), float(low), float(high))


def _resampled_mean(returns: Matrix, rng: np.random.Generator) -> float:
    policies, episodes = returns.shape
    rows = rng.integers(policies, size=(policies, 1))
    return float(np.mean(returns[rows, rng.integers(episodes, size=(policies, episodes))]))

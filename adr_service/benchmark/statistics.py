"""Aggregates of returns with their 95 % intervals.

A mean has Student's interval over the means of seeds, because a bootstrap of few seeds is too
short: `benchmarks/coverage.py` measures how often either covers the truth (docs/statistics.md).
Aggregates that are no means have a bootstrap over seeds, policies and episodes. Samples of the same
policies (trained for one variant of a task, and evaluated on another as well) are not independent:
they get the same draws, if they have the same seeds. Fewer than three seeds have no interval: with
two, Student's is 18 standard deviations of seeds long, and the bootstrap covers half of the truths.

The interquartile mean and the probability of improvement are those of Agarwal et al., "Deep
Reinforcement Learning at the Edge of the Statistical Precipice", arXiv 2108.13264, Sec. 4. We
compute them ourselves, because their library rliable does not import beside current pandas.
"""

from collections.abc import Callable, Hashable, Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata, trim_mean
from scipy.stats import t as student

from adr_service.arrays import Matrix, Vector
from adr_service.errors import InvalidInput

_RESAMPLES = 2000
_LEVEL = 0.95
FEWEST_SEEDS = 3  # for an interval
_FEWEST_RANKED = 5  # seeds of each method, for an interval of the probability of improvement
_CHUNK = 1_000_000  # returns drawn at once


@dataclass(frozen=True)
class Interval:
    """An aggregate with its 95 % interval."""

    value: float
    low: float | None  # None: fewer than three seeds have no interval
    high: float | None

    def __str__(self) -> str:
        if self.low is None or self.high is None:
            return f"{self.value:.2f}"
        return f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"


def seed_interval(values: Vector, fewest: int = FEWEST_SEEDS) -> Interval:
    """The mean of seeds' values (n,) with Student's interval, if they are not too few."""
    centre, count = float(values.mean()), len(values)
    if count < fewest:
        return Interval(centre, None, None)
    reach = float(student.isf((1 - _LEVEL) / 2, count - 1) * values.std(ddof=1) / np.sqrt(count))
    return Interval(centre, centre - reach, centre + reach)


def mean_interval(seeds: Sequence[Matrix]) -> Interval:
    """The mean return of seeds, each a (policies, episodes) array, with its interval."""
    if not seeds or any(returns.size == 0 for returns in seeds):
        raise InvalidInput("a mean needs at least one return of at least one seed")
    return seed_interval(np.array([returns.mean() for returns in seeds]))


def interquartile_mean(scores: Matrix) -> Vector:
    """Means of the middle half of scores (..., n) over the last axis; of all if n < 4."""
    # Agarwal et al., Sec. 4.3: the 25 % trimmed mean
    return np.asarray(trim_mean(scores, 0.25, axis=-1))


def bootstrap_interval(
    seeds: Sequence[Matrix],
    aggregate: Callable[[Matrix], Vector],
    rng: np.random.Generator,
    fewest: int = FEWEST_SEEDS,
) -> Interval:
    """An aggregate of the policies' mean returns, with its bootstrap interval.

    Each seed is a (policies, episodes) array, all with the same number of policies. The bootstrap
    resamples seeds, then policies, then episodes, so the interval covers repetitions of the whole
    experiment. With few seeds it is too short (three seeds have ten distinct resamples): report
    their number with it.
    """
    return stratified_intervals([seeds], [aggregate], rng, fewest)[0]


def stratified_intervals(
    cells: Sequence[Sequence[Matrix]],
    aggregates: Sequence[Callable[[Matrix], Vector]],
    rng: np.random.Generator,
    fewest: int = FEWEST_SEEDS,
    policies: Sequence[Hashable] | None = None,
) -> list[Interval]:
    """Several aggregates over all cells' policies, from the same resamples.

    `cells`: of each cell, the returns of each seed, (policies, episodes). A cell's seeds are
    resampled by themselves, or as those of another cell with equal `policies`, if these are given,
    one for each cell.
    """
    resampled = np.hstack(_resampled_cells(cells, rng, policies))
    means = np.concatenate([_policy_means(seeds) for seeds in cells])
    has_interval = min(map(len, cells)) >= fewest
    return [_percentile_interval(float(a(means)), a(resampled), has_interval) for a in aggregates]


def improvement(
    one: Sequence[Matrix],
    other: Sequence[Matrix],
    rng: np.random.Generator,
    policies: tuple[Hashable, Hashable] | None = None,
) -> Interval:
    """The probability that a policy of `one` earns more than one of `other`, ties counted half.

    There is no interval if either has fewer than five seeds: of two equal methods with three, one
    wins all pairs in a tenth of cases, and the bootstrap then shows no spread. Both get the same
    draws if their `policies` are given and equal.

    `one`, `other`: returns of each seed, (policies, episodes).
    """

    def wins(a: Matrix, b: Matrix) -> Vector:
        # Agarwal et al., Sec. 4.3: P(X > Y) = mean of S(x, y), S = 1, 1/2, 0 for x >, =, < y, which
        # is Mann and Whitney's U over the number of pairs; U follows from ranks without the pairs
        n, m = a.shape[-1], b.shape[-1]
        ranks = rankdata(np.concatenate([a, b], axis=-1), axis=-1)[..., :n]
        return (ranks.sum(axis=-1) - n * (n + 1) / 2) / (n * m)

    means = [_policy_means(seeds) for seeds in (one, other)]
    resampled = _resampled_cells([one, other], rng, policies)
    has_interval = min(len(one), len(other)) >= _FEWEST_RANKED
    return _percentile_interval(float(wins(*means)), wins(*resampled), has_interval)


def _policy_means(seeds: Sequence[Matrix]) -> Vector:
    """The mean return of every policy of all seeds, (seeds * policies,)."""
    return np.concatenate([returns.mean(axis=1) for returns in seeds])


def _resampled_cells(
    cells: Sequence[Sequence[Matrix]],
    rng: np.random.Generator,
    policies: Sequence[Hashable] | None,
) -> list[Matrix]:
    """Mean returns of policies by cell, (resamples, seeds * policies)."""
    known: dict[Hashable, np.random.Generator] = {}  # as it was before the first cell's draws
    parts: list[Matrix] = []
    for number, seeds in enumerate(cells):
        key = number if policies is None else policies[number]
        own = deepcopy(known[key]) if key in known else rng
        known.setdefault(key, deepcopy(rng))
        parts.append(_resampled(seeds, own).reshape(_RESAMPLES, -1))
    return parts


def _resampled(seeds: Sequence[Matrix], rng: np.random.Generator) -> Matrix:
    """Mean returns of policies in resampled experiments, (resamples, seeds, policies)."""
    if not seeds or any(returns.size == 0 for returns in seeds):
        raise InvalidInput("an interval needs at least one return of at least one seed")
    if len({len(returns) for returns in seeds}) > 1:
        raise InvalidInput(f"seeds differ in policies: {[len(returns) for returns in seeds]}")
    count, policies = len(seeds), len(seeds[0])
    scores = np.empty((_RESAMPLES, count, policies))
    # seed by seed and in chunks, because all draws at once may not fit into memory
    for place in range(count):
        chosen = rng.integers(count, size=_RESAMPLES)
        for index, returns in enumerate(seeds):
            rows = np.flatnonzero(chosen == index)
            for part in np.array_split(rows, 1 + len(rows) * returns.size // _CHUNK):
                scores[part, place] = _resampled_policies(returns, len(part), rng)
    return scores


def _resampled_policies(returns: Matrix, count: int, rng: np.random.Generator) -> Matrix:
    """Mean returns of `count` resamples of policies and their episodes, (count, policies)."""
    policies, episodes = returns.shape
    rows = rng.integers(policies, size=(count, policies, 1))
    columns = rng.integers(episodes, size=(count, policies, episodes))
    return returns[rows, columns].mean(axis=2)


def _percentile_interval(value: float, resampled: Vector, has_interval: bool) -> Interval:
    """The percentile bootstrap interval (Efron and Tibshirani 1993, ch. 13)."""
    if not has_interval:
        return Interval(value, None, None)
    tail = 100 * (1 - _LEVEL) / 2
    low, high = np.percentile(resampled, [tail, 100 - tail])
    return Interval(value, float(low), float(high))

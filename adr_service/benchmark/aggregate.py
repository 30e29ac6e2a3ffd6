"""Methods over all tasks and variants: means, interquartile means and performance profiles.

    for each in aggregates(outcomes):
        print(each.method, each.mean, each.low, each.high)

The mean is over cells, with Student's interval over seeds: policies that fail count in full. All
else is after Agarwal et al., arXiv 2108.13264, Sec. 4: the scores of all cells together, with a
bootstrap that draws seeds within each cell. A cell is a task's variant. Policies that were
evaluated on several variants get the same draws in each. Cells are compared after the iteration of
`final_outcomes`, with SimOpt's data, and count only if all methods have them. A method that learns
from target data has no cell at iteration 0. A method that lacks a cell which most methods have is
left out, so that one which has just begun does not empty the tables.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.benchmark.comparison import (
    Outcome,
    Policies,
    final_outcomes,
    policies_of,
    returns_of,
)
from adr_service.benchmark.statistics import (
    Interval,
    interquartile_mean,
    seed_interval,
    stratified_intervals,
)
from adr_service.methods.catalogue import methods
from adr_service.randomness import stream

_LEVELS = np.linspace(0.0, 1.5, 61)  # of normalised returns


@dataclass(frozen=True)
class _Cell:
    """A method's seeds on a task's variant."""

    seeds: list[int]
    returns: list[Matrix]  # (policies, episodes) of each seed
    policies: Policies


@dataclass(frozen=True)
class Aggregate:
    """A method's policies over several cells."""

    method: str
    cells: int  # pairs of task and variant
    mean: float  # over cells, of the seeds' mean normalised returns
    low: float | None  # of Student's interval; None: too few seeds, or other ones in each cell
    high: float | None
    interquartile_mean: float  # of the policies' mean normalised returns, without the worst quarter
    interquartile_low: float | None  # of the stratified bootstrap; None: a cell has too few seeds
    interquartile_high: float | None
    seeds: int  # fewest of a cell
    policies: int  # different ones


@dataclass(frozen=True)
class ProfilePoint:
    """A point of a method's performance profile."""

    method: str
    level: float  # a normalised return
    share: float  # of the policies that earn more on average
    low: float | None
    high: float | None


def aggregates(outcomes: Sequence[Outcome]) -> list[Aggregate]:
    """One row per method, as catalogued; none where the methods have no cell in common."""
    return [_aggregate(method, cells) for method, cells in _common(outcomes).items()]


def profiles(outcomes: Sequence[Outcome]) -> list[ProfilePoint]:
    """The performance profiles of all methods, level by level."""
    return [
        ProfilePoint(method, float(level), share.value, share.low, share.high)
        for method, cells in _common(outcomes).items()
        for level, share in zip(_LEVELS, _shares(cells), strict=True)
    ]


def has_common_cells(outcomes: Sequence[Outcome]) -> bool:
    """True if there is a task's variant that all methods but those left out have."""
    return bool(_common(outcomes))


def _shares(cells: Sequence[_Cell]) -> list[Interval]:
    """The shares of policies that earn more than each of `_LEVELS`."""
    above = [partial(_share_above, level=float(level)) for level in _LEVELS]
    return _intervals(cells, above, stream("profile"))


def _intervals(
    cells: Sequence[_Cell],
    aggregates: Sequence[Callable[[Matrix], Vector]],
    rng: np.random.Generator,
) -> list[Interval]:
    returns = [cell.returns for cell in cells]
    return stratified_intervals(returns, aggregates, rng, policies=[c.policies for c in cells])


def _share_above(scores: Matrix, level: float) -> Vector:
    return (scores > level).mean(axis=-1)


def _common(outcomes: Sequence[Outcome]) -> dict[str, list[_Cell]]:
    """Returns by method, in the cells that all these methods have; see the module."""
    cells = {
        cell: {name: found for name, found in columns.items() if not _has_learned_nothing(found[0])}
        for cell, columns in sorted(final_outcomes(outcomes).items())
    }
    having = {name: {c for c in cells if name in cells[c]} for name in methods()}
    having = {name: own for name, own in having.items() if own}
    held = Counter(cell for own in having.values() for cell in own)
    most = {cell for cell, count in held.items() if 2 * count > len(having)}
    names = [name for name, own in having.items() if own >= most]
    shared = [columns for columns in cells.values() if all(name in columns for name in names)]
    if not shared:
        return {}
    return {name: [_cell(columns[name]) for columns in shared] for name in names}


def _has_learned_nothing(outcome: Outcome) -> bool:
    learns = outcome.spec.method.learns_from != "nothing"
    return learns and outcome.iteration.iteration == 0


def _cell(outcomes: Sequence[Outcome]) -> _Cell:
    ordered = sorted(outcomes, key=lambda outcome: outcome.spec.seed)
    return _Cell([o.spec.seed for o in ordered], returns_of(ordered), policies_of(ordered))


def _aggregate(method: str, cells: Sequence[_Cell]) -> Aggregate:
    mean = _mean(cells)
    (middle,) = _intervals(cells, [interquartile_mean], stream("aggregate"))
    return Aggregate(
        method=method,
        cells=len(cells),
        mean=mean.value,
        low=mean.low,
        high=mean.high,
        interquartile_mean=middle.value,
        interquartile_low=middle.low,
        interquartile_high=middle.high,
        seeds=min(len(cell.returns) for cell in cells),
        policies=len({policy for cell in cells for own in cell.policies for policy in own}),
    )


def _mean(cells: Sequence[_Cell]) -> Interval:
    earned = [np.array([returns.mean() for returns in cell.returns]) for cell in cells]
    if all(cell.seeds == cells[0].seeds for cell in cells):
        return seed_interval(np.mean(earned, axis=0))
    return Interval(float(np.mean([each.mean() for each in earned])), None, None)

"""Checks of claims: each judges some cells by their intervals, and says the numbers.

    check = higher(Cell("hopper", "vanilla", "dropo"), Cell("hopper", "vanilla", "udr"))
    verdict, evidence = check(Measured(outcomes))

A comparison is supported or contradicted by its 95 % interval, and undecided if the interval does
not settle it or if only one seed was run. A check without an interval (widths, costs) must hold
for every seed.
"""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Literal

from adr_service.benchmark.cells import Cell, Measured
from adr_service.benchmark.comparison import returns_of, table
from adr_service.benchmark.statistics import Interval, difference, interval, mean
from adr_service.randomness import stream

ClaimVerdict = Literal["supported", "contradicted", "undecided", "not measured"]
_SOLVED = 0.95  # normalised target return
_SAME = 0.1  # of a normalised return
_POINT = 0.05  # standard deviation in [0, 4] below which a distribution is a point
_DECISIVE: tuple[ClaimVerdict, ...] = ("contradicted", "not measured", "undecided")  # in order
Answer = tuple[ClaimVerdict, list[str]]
Check = Callable[[Measured], Answer]


def solves(cell: Cell) -> Check:
    """The interval of the normalised return lies above `_SOLVED`."""

    def check(measured: Measured) -> Answer:
        outcomes = list(measured.of(cell).values())
        if not outcomes:
            return "not measured", []
        earned = interval(returns_of(outcomes), mean, stream("claims"))
        evidence = [f"{cell}: {_numbers(earned)}, {_seeds(len(outcomes))}"]
        return _by_several(beyond(earned, _SOLVED), len(outcomes)), evidence

    return check


def fails(cell: Cell) -> Check:
    """The method does not solve the task."""
    return lambda measured: _negation(solves(cell)(measured))


def compared(
    ones: Sequence[Cell], others: Sequence[Cell], judge: Callable[[Interval], ClaimVerdict]
) -> Check:
    """A judgement of the difference between two methods, averaged over cells."""

    def check(measured: Measured) -> Answer:
        pairs = [(measured.of(a), measured.of(b)) for a, b in zip(ones, others, strict=True)]
        common = [sorted(a.keys() & b.keys()) for a, b in pairs]
        same = [
            a.key == b.key and measured.resolve(a) == measured.resolve(b)
            for a, b in zip(ones, others, strict=True)
        ]
        if not all(common) or any(same):
            return "not measured", []
        sides = [
            [
                returns_of([pair[side][s] for s in seeds])
                for pair, seeds in zip(pairs, common, strict=True)
            ]
            for side in (0, 1)
        ]
        gap, seeds = difference(sides[0], sides[1], stream("claims")), min(map(len, common))
        names = f"{ones[0]} minus {others[0]}"
        if len(ones) > 1:
            names = f"{ones[0].method} minus {others[0].method}, mean of {len(ones)} cells"
        return _by_several(judge(gap), seeds), [f"{names}: {_numbers(gap)}, {_seeds(seeds)}"]

    return check


def higher(one: Cell, other: Cell) -> Check:
    """One method earns more than another."""
    return compared([one], [other], lambda gap: beyond(gap, 0.0))


def at_least(one: Cell, other: Cell) -> Check:
    """One method earns as much as another, or less by `_SAME` at most."""
    return compared([one], [other], lambda gap: beyond(gap, -_SAME))


def equal(one: Cell, other: Cell) -> Check:
    """Two methods earn the same within `_SAME`."""
    return compared([one], [other], _within)


def drops(task: str, variant: str, method: str) -> Check:
    """More target data made the method worse at some iteration, by more than `_SAME`."""

    def check(measured: Measured) -> Answer:
        iterations = measured.iterations(Cell(task, variant, method))
        known = [Cell(task, variant, method, i) for i in iterations if i > 0]
        if len(known) < 2:
            return "not measured", []
        fallen = [
            compared([a], [b], lambda gap: beyond(gap, _SAME))(measured)
            for a, b in combinations(known, 2)
        ]
        return _disjunction(fallen)

    return check


def narrow(cell: Cell) -> Check:
    """The inferred distribution is practically a point."""

    def check(measured: Measured) -> Answer:
        stds = [row.posterior_std for o in measured.of(cell).values() for row in table([o])]
        known = [std for std in stds if std is not None]
        if not known:
            return "not measured", []
        evidence = [f"{cell}: standard deviation {_range(known)} in [0, 4], {_seeds(len(known))}"]
        return _for_every([std < _POINT for std in known]), evidence

    return check


def costs_more(task: str, dear: str, cheap: str) -> Check:
    """One inference of `dear` simulates more than one of `cheap`, from the same data."""

    def check(measured: Measured) -> Answer:
        one, other = (measured.of(Cell(task, "vanilla", name, 1)) for name in (dear, cheap))
        pairs = [
            (one[seed].iteration.inference_steps, other[seed].iteration.inference_steps)
            for seed in sorted(one.keys() & other.keys())
        ]
        if not pairs:
            return "not measured", []
        steps = [_range([float(pair[side]) for pair in pairs]) for side in (0, 1)]
        evidence = f"{task}: {dear} simulates {steps[0]} steps, {cheap} {steps[1]}"
        return _for_every([a > b for a, b in pairs]), [f"{evidence}, {_seeds(len(pairs))}"]

    return check


def _by_several(verdict: ClaimVerdict, seeds: int) -> ClaimVerdict:
    """One seed settles nothing, whatever its episodes' interval."""
    return verdict if seeds > 1 else "undecided"


def _for_every(holds: Sequence[bool]) -> ClaimVerdict:
    """Verdict on a condition that must hold for each seed."""
    if all(holds):
        return _by_several("supported", len(holds))
    return "undecided" if any(holds) else _by_several("contradicted", len(holds))


def beyond(measured: Interval, bound: float) -> ClaimVerdict:
    """Supported if the whole interval lies above the bound, contradicted if it lies below."""
    if measured.low >= bound:
        return "supported"
    return "contradicted" if measured.high < bound else "undecided"


def _within(gap: Interval) -> ClaimVerdict:
    if gap.low >= -_SAME and gap.high <= _SAME:
        return "supported"
    return "contradicted" if gap.low > _SAME or gap.high < -_SAME else "undecided"


def _negation(answer: Answer) -> Answer:
    verdict, evidence = answer
    swapped: dict[ClaimVerdict, ClaimVerdict] = {
        "supported": "contradicted",
        "contradicted": "supported",
    }
    return swapped.get(verdict, verdict), evidence


def conjunction(answers: Sequence[Answer]) -> Answer:
    """The verdict on all answers: one contradiction contradicts, one gap leaves it open."""
    verdicts = [verdict for verdict, _ in answers]
    evidence = [line for _, lines in answers for line in lines]
    for verdict in _DECISIVE:
        if verdict in verdicts:
            return verdict, evidence
    return "supported", evidence


def _disjunction(answers: Sequence[Answer]) -> Answer:
    return _negation(conjunction([_negation(answer) for answer in answers]))


def _numbers(measured: Interval) -> str:
    return f"{measured.value:.2f} [{measured.low:.2f}, {measured.high:.2f}]"


def _seeds(count: int) -> str:
    return f"{count} seed{'s' if count > 1 else ''}"


def _range(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.2g}" if low == high else f"{low:.2g} to {high:.2g}"


def _any_of(checks: Sequence[Check]) -> Check:
    return lambda measured: _disjunction([check(measured) for check in checks])


def all_of(checks: Sequence[Check]) -> Check:
    """All checks hold."""
    return lambda measured: conjunction([check(measured) for check in checks])


def none_of(checks: Sequence[Check]) -> Check:
    """No check holds."""
    return lambda measured: _negation(_any_of(checks)(measured))

"""Checks of claims: each says how surely some cells speak for a statement, and against it.

    check = higher(Cell("hopper", "vanilla", "dropo"), Cell("hopper", "vanilla", "udr"))
    answer = check(Measured(outcomes))
    answer.supports, answer.contradicts     # p-values of the opposites

Methods are compared seed by seed: those of one seed learn from the same collected data, and start
from the same trained policies. The p-values are those of Student's t over the seeds. A statement
about returns needs an oracle that was trained well enough; without one, undertrained policies would
be mistaken for failed methods. Checks of widths and costs must hold for every seed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, get_args

import numpy as np
from scipy.stats import t as student

from adr_service.arrays import Vector
from adr_service.benchmark.cells import Cell, Measured
from adr_service.benchmark.comparison import Outcome, returns_of, table
from adr_service.benchmark.statistics import FEWEST_SEEDS, seed_interval

_SOLVED = 0.95  # of the oracle's target return
_SAME = 0.1  # of a normalised return
_POINT = 0.05  # standard deviation in [0, 4] below which a distribution is a point
_TRAINED = 0.9  # normalised target return, and share of its policies that reached the threshold
_MOST_SEEDS = 1000
# Least standard deviation over seeds: two trainings on one distribution differ by about as much
# (docs/training.md, the oracle on Hopper). Seeds that share a policy, or a gait, have none at all.
_LEAST_STD = 0.02
Gap = Literal["not judged", "measured in part", "not measured"]  # why a statement has no verdict
GAPS: tuple[Gap, ...] = get_args(Gap)  # the first counts where there are several


@dataclass(frozen=True)
class Evidence:
    """The evidence of one or several checks for a statement, and against it."""

    supports: float  # p-value of the statement's opposite
    contradicts: float  # p-value of the statement
    lines: list[str]
    gap: Gap | None = None
    is_tested: bool = True  # False: it must hold for every seed, and has no error of a test
    needed: Callable[[float], float] = lambda level: float("inf")  # seeds for a two-sided level
    in_part: bool = False  # at least one of several checks was measured
    leans: bool | None = None  # of joined checks: all lean to support; None: decided by p-values

    @property
    def is_measured(self) -> bool:
        """True if there was something to test, whatever came out: such claims share the level."""
        return self.gap is None or self.in_part

    @property
    def leans_to_support(self) -> bool:
        """True if the measured values speak for the statement rather than against it."""
        return self.supports <= self.contradicts if self.leans is None else self.leans


Check = Callable[[Measured], Evidence]


def solves(cell: Cell) -> Check:
    """The method earns more than `_SOLVED` of what the variant's own oracle earns."""

    def check(measured: Measured) -> Evidence:
        ceiling = Cell(cell.task, cell.variant, "oracle")
        if gap := _gap_of(measured, [cell]):
            return gap
        earned, most = (_by_seed(measured.of(each)) for each in (cell, ceiling))
        seeds = sorted(earned.keys() & most.keys())
        if not seeds:
            return _nothing([f"{cell} and the oracle have no seed in common"])
        over = np.array([earned[seed] - _SOLVED * most[seed] for seed in seeds])
        own, best = (
            seed_interval(np.array([side[seed] for seed in seeds])) for side in (earned, most)
        )
        trained = _trained(measured.of(cell))
        line = f"{cell}: {own} of the oracle's {best.value:.2f}, {_seeds(len(seeds))}; {trained}"
        return above(over, 0.0, line)

    return check


def fails(cell: Cell) -> Check:
    """The method does not solve the task."""
    return lambda measured: _negation(solves(cell)(measured))


def compared(
    ones: Sequence[Cell], others: Sequence[Cell], judge: Callable[[Vector, str], Evidence]
) -> Check:
    """A judgement of the difference between two methods, averaged over cells, seed by seed."""

    def check(measured: Measured) -> Evidence:
        pairs = list(zip(ones, others, strict=True))
        if any(a.key == b.key and measured.resolve(a) == measured.resolve(b) for a, b in pairs):
            return _nothing([])  # a method after its only iteration is no better than itself
        if gap := _gap_of(measured, [*ones, *others]):
            return gap
        differences = [
            _differences(_by_seed(measured.of(a)), _by_seed(measured.of(b))) for a, b in pairs
        ]
        seeds = sorted(set[int].intersection(*(set(each) for each in differences)))
        if not seeds:
            return _nothing([f"{ones[0]} and {others[0]} have no seed in common"])
        names = f"{ones[0]} minus {others[0]}"
        if len(ones) > 1:
            names = f"{ones[0].method} minus {others[0].method}, mean of {len(ones)} cells"
        means = np.array(
            [sum(each[seed] for each in differences) / len(differences) for seed in seeds]
        )
        sides = (f"{a[0].method}, {_trained(*map(measured.of, a))}" for a in (ones, others))
        line = f"{names}: {seed_interval(means)}, {_seeds(len(seeds))}; {'; '.join(sides)}"
        return judge(means, line)

    return check


def higher(one: Cell, other: Cell) -> Check:
    """One method earns more than another."""
    return compared([one], [other], lambda differences, line: above(differences, 0.0, line))


def at_least(one: Cell, other: Cell) -> Check:
    """One method earns as much as another, or less by `_SAME` at most."""
    return compared([one], [other], lambda differences, line: above(differences, -_SAME, line))


def equal(one: Cell, other: Cell) -> Check:
    """Two methods earn the same within `_SAME` (two one-sided tests; Schuirmann 1987)."""
    return compared([one], [other], _within)


def drops(task: str, variant: str, method: str) -> Check:
    """More target data made the method worse at some iteration, by more than `_SAME`."""

    def check(measured: Measured) -> Evidence:
        iterations = measured.iterations(Cell(task, variant, method))
        known = [Cell(task, variant, method, i) for i in iterations if i > 0]
        if len(known) < 2:
            few = f"{method} on {task} {variant} has fewer than two iterations of the same seeds"
            is_there = measured.of(Cell(task, variant, method, 0))
            return _nothing([few] if iterations or is_there else [])
        fallen = [
            compared([a], [b], lambda differences, line: above(differences, _SAME, line))(measured)
            for a, b in combinations(known, 2)
        ]
        return _disjunction(fallen)

    return check


def narrow(cell: Cell) -> Check:
    """The inferred distribution is practically a point."""

    def check(measured: Measured) -> Evidence:
        stds = [row.posterior_std for o in measured.of(cell).values() for row in table([o])]
        known = [std for std in stds if std is not None]
        if not known:
            return _nothing([])
        line = f"{cell}: standard deviation {_range(known)} in [0, 4], {_seeds(len(known))}"
        return _for_every([std < _POINT for std in known], line)

    return check


def costs_more(task: str, dear: str, cheap: str) -> Check:
    """One inference of `dear` simulates more than one of `cheap`, from the same data."""

    def check(measured: Measured) -> Evidence:
        one, other = (measured.of(Cell(task, "vanilla", name, 1)) for name in (dear, cheap))
        pairs = [
            (one[seed].iteration.inference_steps, other[seed].iteration.inference_steps)
            for seed in sorted(one.keys() & other.keys())
        ]
        if not pairs:
            return _nothing([])
        steps = [_range([float(pair[side]) for pair in pairs]) for side in (0, 1)]
        line = f"{task} vanilla after 1: {dear} simulates {steps[0]} steps, {cheap} {steps[1]}"
        return _for_every([a > b for a, b in pairs], f"{line}, {_seeds(len(pairs))}")

    return check


def above(values: Vector, bound: float, line: str) -> Evidence:
    """The mean of seeds' values (n,) lies above a bound; one or two settle nothing."""
    count, centre = len(values), float(values.mean()) - bound
    if count < FEWEST_SEEDS:
        leaning = (0.5, 1.0) if centre > 0 else (1.0, 0.5)
        return Evidence(*leaning, [line])
    std = max(float(values.std(ddof=1)), _LEAST_STD)
    score = centre * np.sqrt(count) / std
    supports, contradicts = student.sf(score, count - 1), student.cdf(score, count - 1)
    needed = _seeds_needed(abs(centre), std)
    return Evidence(float(supports), float(contradicts), [line], needed=needed)


def _within(differences: Vector, line: str) -> Evidence:
    """The mean of seeds' values (n,) lies within `_SAME` of zero."""
    return conjunction([above(differences, -_SAME, line), above(-differences, -_SAME, line)])


def _seeds_needed(distance: float, std: float) -> Callable[[float], float]:
    """Seeds at which Student's t settles a mean at a distance from its bound, by level."""

    def needed(level: float) -> float:
        for count in range(FEWEST_SEEDS, _MOST_SEEDS + 1):
            if distance * np.sqrt(count) > std * student.isf(level / 2, count - 1):
                return float(count)
        return float("inf")

    return needed


def _gap_of(measured: Measured, cells: Sequence[Cell]) -> Evidence | None:
    """The reason why returns of these cells cannot be judged, if there is one."""
    if not all(measured.of(cell) for cell in cells):
        return _nothing([])
    lines: list[str] = []
    for task, variant in dict.fromkeys((cell.task, cell.variant) for cell in cells):
        oracle = measured.of(Cell(task, variant, "oracle"))
        if not oracle:
            return _nothing([f"there is no oracle on {task} {variant} to judge by"])
        earned = seed_interval(np.array(list(_by_seed(oracle).values()))).value
        flags = _reached(oracle)
        if min(earned, float(np.mean(flags))) < _TRAINED:
            lines.append(
                f"trainings on {task} {variant} are too short to judge methods by: the oracle "
                f"earns {earned:.2f}, {_trained(oracle)}"
            )
    return Evidence(1.0, 1.0, lines, "not judged") if lines else None


def _trained(*cells: dict[int, Outcome]) -> str:
    """Count policies that reached the threshold; those that did not may settle a claim alone."""
    flags = _reached(*cells)
    return f"{sum(flags)} of {len(flags)} policies reached the threshold on their source"


def _reached(*cells: dict[int, Outcome]) -> list[bool]:
    outcomes = (outcome for cell in cells for outcome in cell.values())
    return [flag for outcome in outcomes for flag in outcome.iteration.reached_threshold]


def _nothing(lines: list[str]) -> Evidence:
    return Evidence(1.0, 1.0, lines, "not measured")


def _by_seed(outcomes: dict[int, Outcome]) -> dict[int, float]:
    """Mean normalised target returns by seed."""
    return {
        seed: float(returns.mean())
        for seed, returns in zip(outcomes, returns_of(list(outcomes.values())), strict=True)
    }


def _differences(one: dict[int, float], other: dict[int, float]) -> dict[int, float]:
    return {seed: one[seed] - other[seed] for seed in one.keys() & other.keys()}


def _for_every(holds: Sequence[bool], line: str) -> Evidence:
    """A condition that must hold for each of several seeds."""
    several = len(holds) >= FEWEST_SEEDS
    needed = float(FEWEST_SEEDS) if all(holds) or not any(holds) else float("inf")
    return Evidence(
        0.0 if all(holds) and several else 1.0,
        0.0 if not any(holds) and several else 1.0,
        [line],
        is_tested=False,
        needed=lambda level: needed,
    )


def _negation(answer: Evidence) -> Evidence:
    leans = None if answer.leans is None else not answer.leans
    return replace(answer, supports=answer.contradicts, contradicts=answer.supports, leans=leans)


def conjunction(answers: Sequence[Evidence]) -> Evidence:
    """The evidence that all of several checks hold.

    It is supported as surely as the weakest (an intersection-union test, which needs no
    correction), and contradicted by the strongest contradiction, corrected for their number
    (Bonferroni). A check without a verdict leaves the support open, not the contradiction.
    """
    gaps: list[Gap] = [answer.gap for answer in answers if answer.gap is not None]
    if 0 < len(gaps) < len(answers):
        gaps.append("measured in part")
    lines = list(dict.fromkeys(line for answer in answers for line in answer.lines))
    against = [answer for answer in answers if not answer.leans_to_support]
    judged = [each for each in answers if each.is_measured]
    count = max(1, len(judged))

    def needed(level: float) -> float:
        if against:
            return min(answer.needed(level / count) for answer in against)
        return max(answer.needed(level) for answer in answers)

    return Evidence(
        max(answer.supports for answer in answers),
        min(1.0, count * min(answer.contradicts for answer in answers)),
        lines,
        min(gaps, default=None, key=GAPS.index),
        any(answer.is_tested for answer in judged or answers),
        needed,
        bool(judged),
        not against,
    )


def _disjunction(answers: Sequence[Evidence]) -> Evidence:
    return _negation(conjunction([_negation(answer) for answer in answers]))


def all_of(checks: Sequence[Check]) -> Check:
    """All checks hold."""
    return lambda measured: conjunction([check(measured) for check in checks])


def none_of(checks: Sequence[Check]) -> Check:
    """No check holds."""
    return lambda measured: conjunction([_negation(check(measured)) for check in checks])


def _seeds(count: int) -> str:
    return f"{count} seed{'s' if count > 1 else ''}"


def _range(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.2g}" if low == high else f"{low:.2g} to {high:.2g}"

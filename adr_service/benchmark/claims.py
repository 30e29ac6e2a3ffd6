"""Claims of the paper, held against the runs at hand.

    for report in reports(outcomes):        # one per budget, such as a preset
        for finding in report.findings:
            print(finding.claim, finding.verdict)

The claims are those of Tiboni et al., "Online vs. Offline Adaptive Domain Randomization
Benchmark", in words. The paper has no numbers that could be compared, and does not say what it
means by "solves", "fails" and "equal". Here a method solves a task if it earns more than 0.95 of
what the variant's oracle earns, and fails if it earns less. Two methods are equal if they differ by
less than 0.1 of the reward threshold. `adr_service.benchmark.checks` tests these seed by seed.

Twenty-one claims are judged at once, so that one in twenty would be settled by chance. Verdicts on
returns hold together at 95 %: the p-values are corrected for the number of claims (Holm 1979). An
undecided claim tells how many seeds might settle it, if their means and spread were those measured.
Claims on widths and costs (U5, C1) must hold for every seed, and are not part of that.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from adr_service.benchmark.budgets import by_budget, changes
from adr_service.benchmark.cells import Cell, Measured
from adr_service.benchmark.checks import (
    Check,
    Evidence,
    Gap,
    above,
    all_of,
    at_least,
    compared,
    conjunction,
    costs_more,
    drops,
    equal,
    fails,
    higher,
    narrow,
    none_of,
    solves,
)
from adr_service.benchmark.comparison import Outcome
from adr_service.specs import SimulatedTarget

METHODS = ("udr", "bayrn", "simopt", "simopt_1", "droid", "dropo")
_HARD = ("half_cheetah", "walker2d", "humanoid")
TASKS = ("hopper", *_HARD)
_VARIANTS = ("vanilla", "noisy", "unmodeled")
_LEVEL = 0.05  # at which all verdicts hold together
ClaimVerdict = Literal["supported", "contradicted", "undecided"] | Gap


@dataclass(frozen=True)
class ClaimReport:
    """The verdict on a claim, with the numbers behind it."""

    claim: str  # "V1"
    statement: str
    verdict: ClaimVerdict
    evidence: list[str]
    # of an undecided claim, at the present spread; None: too many, or fewer than three so far
    seeds_needed: int | None


@dataclass(frozen=True)
class Report:
    """The verdicts on all claims, from the runs under one budget."""

    preset: str
    changed: dict[str, object]  # fields of the budget that are not the preset's
    findings: list[ClaimReport]


def reports(outcomes: Iterable[Outcome]) -> list[Report]:
    """One report for each budget, which has one setting of every method.

    Left out are smoke runs, which mean nothing, and runs that the paper does not have: with effects
    beyond its tasks, or with a target that is not simulated.
    """
    return [_report(part) for part in by_budget(filter(_is_the_papers, outcomes))]


def _is_the_papers(outcome: Outcome) -> bool:
    spec = outcome.spec
    is_plain = isinstance(spec.target, SimulatedTarget) and not spec.extension
    return (
        is_plain
        and not spec.hidden_effects
        and spec.preset != "smoke"
        and bool(outcome.iteration.returns)
    )


def _report(outcomes: Sequence[Outcome]) -> Report:
    measured = Measured(outcomes)
    evidence = [conjunction([check(measured) for check in claim.checks]) for claim in CLAIMS]
    return Report(outcomes[0].spec.preset, changes(outcomes), _judged(evidence, CLAIMS))


def _judged(evidence: Sequence[Evidence], claims: Sequence["Claim"]) -> list[ClaimReport]:
    """The verdicts on claims, which hold together at `_LEVEL`."""
    values = [min(1.0, 2 * min(each.supports, each.contradicts)) for each in evidence]
    measured = [i for i, each in enumerate(evidence) if each.is_tested and each.is_measured]
    settled = {i for i, each in enumerate(evidence) if not each.is_tested and values[i] == 0}
    for place, index in enumerate(sorted(measured, key=lambda i: values[i])):
        if values[index] >= _LEVEL / (len(measured) - place):
            break
        settled.add(index)
    found: list[ClaimReport] = []
    for index, (claim, each) in enumerate(zip(claims, evidence, strict=True)):
        verdict: ClaimVerdict = each.gap or "undecided"
        if index in settled:
            verdict = "supported" if each.leans_to_support else "contradicted"
        needed = each.needed(_LEVEL / max(1, len(measured)))
        seeds = int(needed) if verdict == "undecided" and needed < float("inf") else None
        found.append(ClaimReport(claim.name, claim.statement, verdict, each.lines, seeds))
    return found


@dataclass(frozen=True)
class Claim:
    """A statement that holds if all checks do."""

    name: str
    statement: str
    checks: Sequence[Check]


def _was_run(task: str, method: str) -> bool:
    """True if the paper has the method's returns on the task: it left BayRn out on Humanoid."""
    return (task, method) != ("humanoid", "bayrn")


def _best_of_all(task: str, variant: str, method: str) -> list[Check]:
    others = [name for name in METHODS if name != method and _was_run(task, name)]
    return [at_least(Cell(task, variant, method), Cell(task, variant, name)) for name in others]


def _cells_of(method: str) -> list[tuple[str, str]]:
    tasks = [task for task in TASKS if _was_run(task, method)]
    return [(task, variant) for task in tasks for variant in _VARIANTS]


def _same_whoever_collects(task: str, method: str) -> list[Check]:
    cells = [Cell(task, "noisy", method, None, who) for who in ("simopt", "prior", "random")]
    return [equal(a, b) for a, b in combinations(cells, 2)]


CLAIMS: tuple[Claim, ...] = (
    Claim(
        "V1",
        "Vanilla: every method transfers on Hopper.",
        [solves(Cell("hopper", "vanilla", name)) for name in METHODS],
    ),
    Claim(
        "V2",
        "Vanilla: DROPO solves all four tasks from one trajectory, and equals SimOpt's last.",
        [
            check
            for task in TASKS
            for check in (
                solves(Cell(task, "vanilla", "dropo", 1)),
                equal(Cell(task, "vanilla", "dropo", 1), Cell(task, "vanilla", "simopt")),
            )
        ],
    ),
    Claim(
        "V3",
        "Vanilla: SimOpt improves over iterations, and solves all four tasks.",
        [
            check
            for task in TASKS
            for check in (
                solves(Cell(task, "vanilla", "simopt")),
                higher(Cell(task, "vanilla", "simopt"), Cell(task, "vanilla", "simopt", 0)),
            )
        ],
    ),
    Claim(
        "V4",
        "Vanilla: SimOpt-1 fails on Walker2d.",
        [fails(Cell("walker2d", "vanilla", "simopt_1"))],
    ),
    Claim(
        "V5",
        "Vanilla: on Walker2d, more data can make DROID worse, not SimOpt (which is more stable).",
        [
            drops("walker2d", "vanilla", "droid"),
            none_of([drops("walker2d", "vanilla", "simopt")]),
        ],
    ),
    Claim(
        "V6",
        "Vanilla: BayRn does not solve HalfCheetah and Walker2d.",
        [fails(Cell(task, "vanilla", "bayrn")) for task in ("half_cheetah", "walker2d")],
    ),
    Claim(
        "N1",
        "Noisy: all methods still succeed on Hopper.",
        [solves(Cell("hopper", "noisy", name)) for name in METHODS],
    ),
    Claim(
        "N2",
        "Noisy: DROID and SimOpt-1 can fail on Walker2d.",
        [fails(Cell("walker2d", "noisy", name)) for name in ("droid", "simopt_1")],
    ),
    Claim(
        "N3",
        "Noisy: BayRn fails where there are many parameters.",
        [fails(Cell(task, "noisy", "bayrn")) for task in ("half_cheetah", "walker2d")],
    ),
    Claim(
        "N4",
        "Noisy: SimOpt is lower than in vanilla on hard tasks, and drops on Humanoid after one.",
        [
            *(higher(Cell(t, "vanilla", "simopt"), Cell(t, "noisy", "simopt")) for t in _HARD),
            higher(Cell("humanoid", "noisy", "simopt", 1), Cell("humanoid", "noisy", "simopt")),
        ],
    ),
    Claim(
        "N5",
        "Noisy: DROPO transfers everywhere from one trajectory, no worse with more.",
        [
            check
            for task in TASKS
            for check in (
                solves(Cell(task, "noisy", "dropo", 1)),
                at_least(Cell(task, "noisy", "dropo"), Cell(task, "noisy", "dropo", 1)),
            )
        ],
    ),
    Claim(
        "U1",
        "Unmodeled: offline methods behave as in vanilla.",
        [
            equal(Cell(task, "unmodeled", name), Cell(task, "vanilla", name))
            for task in TASKS
            for name in ("droid", "dropo")
        ],
    ),
    Claim(
        "U2",
        "Unmodeled: SimOpt and SimOpt-1 fail on Humanoid; SimOpt solves the other three.",
        [
            *(fails(Cell("humanoid", "unmodeled", name)) for name in ("simopt", "simopt_1")),
            *(solves(Cell(task, "unmodeled", "simopt")) for task in TASKS[:3]),
        ],
    ),
    Claim(
        "U3",
        "Unmodeled: BayRn beats the other methods on Hopper.",
        [
            higher(Cell("hopper", "unmodeled", "bayrn"), Cell("hopper", "unmodeled", name))
            for name in METHODS
            if name != "bayrn"
        ],
    ),
    Claim(
        "U4",
        "Unmodeled: no method beats DROPO by more than 0.1 on any task.",
        [check for task in TASKS for check in _best_of_all(task, "unmodeled", "dropo")],
    ),
    Claim(
        "U5",
        "Unmodeled: DROID ends with almost no variance.",
        [narrow(Cell(task, "unmodeled", "droid")) for task in TASKS],
    ),
    Claim(
        "D1",
        "Data collection: on Hopper it does not matter who collects.",
        [c for name in ("droid", "dropo") for c in _same_whoever_collects("hopper", name)],
    ),
    Claim(
        "D2",
        "Data collection: on Walker2d it matters for DROID, not for DROPO.",
        [
            *_same_whoever_collects("walker2d", "dropo"),
            none_of([all_of(_same_whoever_collects("walker2d", "droid"))]),
        ],
    ),
    Claim(
        "C1",
        "Cost: DROPO's inference is the dearest, DROID's is cheap (here: simulated steps, vanilla, "
        "first trajectory).",
        [
            costs_more(task, dear, cheap)
            for task in TASKS
            for dear, cheap in (("dropo", "simopt"), ("dropo", "droid"), ("simopt", "droid"))
        ],
    ),
    Claim(
        "C2",
        "Offline methods start better: DROPO beats SimOpt after one trajectory.",
        [higher(Cell(t, "vanilla", "dropo", 1), Cell(t, "vanilla", "simopt", 1)) for t in TASKS],
    ),
    Claim(
        "C3",
        "DROPO has the highest average return over tasks and variants.",
        [
            compared(
                [Cell(task, variant, "dropo") for task, variant in _cells_of(name)],
                [Cell(task, variant, name) for task, variant in _cells_of(name)],
                lambda differences, line: above(differences, 0.0, line),
            )
            for name in METHODS
            if name != "dropo"
        ],
    ),
)

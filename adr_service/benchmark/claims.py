"""What the paper claims, and what the runs at hand say of it.

    for report in reports(outcomes):        # one per budget, such as a preset
        for finding in report.findings:
            print(finding.claim, finding.verdict)

The claims are those of Tiboni et al., "Online vs. Offline Adaptive Domain Randomization
Benchmark", in words. The paper has no numbers that could be compared, and does not say what it
means by "solves", "fails" and "equal"; here: the 95 % interval of the normalised target return
lies above 0.95, lies below it, and the interval of a difference lies within 0.1 of zero. What an
interval does not settle is undecided.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from adr_service.benchmark.comparison import Outcome, costs, returns_of, table
from adr_service.benchmark.statistics import Interval, difference, interval, mean
from adr_service.methods.references import PriorSettings
from adr_service.randomness import stream
from adr_service.specs import RunSpec
from adr_service.wire import canonical_json

Verdict = Literal["supported", "contradicted", "undecided", "not measured"]
_SOLVED = 0.95  # normalised target return
_SAME = 0.1  # of a normalised return
_POINT = 0.05  # standard deviation in [0, 4] below which a distribution is a point
_DECISIVE: tuple[Verdict, ...] = ("contradicted", "not measured", "undecided")  # in this order
_METHODS = ("udr", "bayrn", "simopt", "simopt_1", "droid", "dropo")
_EASY, _HARD = ("hopper",), ("half_cheetah", "walker2d", "humanoid")
_TASKS = (*_EASY, *_HARD)
_VARIANTS = ("vanilla", "noisy", "unmodeled")


@dataclass(frozen=True)
class Finding:
    """A claim, the verdict, and the numbers that bear on it."""

    claim: str  # "V1"
    statement: str
    verdict: Verdict
    evidence: list[str]


@dataclass(frozen=True)
class Report:
    """Findings of all runs under one budget."""

    preset: str
    changed: dict[str, object]  # fields of the budget that are not the preset's
    findings: list[Finding]


def reports(outcomes: Iterable[Outcome]) -> list[Report]:
    """One report per budget; of equal runs, the latest outcome counts. Smoke runs mean nothing."""
    budgets: dict[str, dict[str, Outcome]] = {}
    for outcome in outcomes:
        spec = outcome.spec
        if spec.preset != "smoke" and outcome.iteration.returns:
            cell = f"{spec.task} {spec.variant} {spec.column}"
            key = f"{cell} {spec.seed} {outcome.iteration.iteration}"
            budgets.setdefault(canonical_json(_budget(spec)), {})[key] = outcome
    return [_report(list(latest.values())) for _, latest in sorted(budgets.items())]


def _budget(spec: RunSpec) -> dict[str, object]:
    names = ("preset", "iterations", "transitions", "evaluation_episodes")
    training = {f"training.{k}": v for k, v in spec.training.model_dump().items()}
    return {name: getattr(spec, name) for name in names} | training


def _report(outcomes: Sequence[Outcome]) -> Report:
    spec, measured = outcomes[0].spec, Measured(outcomes)
    plain = RunSpec.model_validate(
        {"task": spec.task, "method": PriorSettings().name, "preset": spec.preset}
    )
    usual, ours = _budget(plain), _budget(spec)
    findings = [
        Finding(claim.name, claim.statement, *_all([check(measured) for check in claim.checks]))
        for claim in CLAIMS
    ]
    return Report(spec.preset, {k: v for k, v in ours.items() if usual[k] != v}, findings)


class Measured:
    """The outcomes of one budget, by what was measured."""

    def __init__(self, outcomes: Sequence[Outcome]):
        self._cells: dict[tuple[str, ...], dict[int, list[Outcome]]] = {}
        for outcome in sorted(outcomes, key=lambda o: o.spec.seed):
            spec, iteration = outcome.spec, outcome.iteration.iteration
            key = (spec.task, spec.variant, spec.method.name, spec.collector)
            self._cells.setdefault(key, {}).setdefault(iteration, []).append(outcome)

    def iterations(self, cell: "Cell") -> list[int]:
        """Those after which the cell's method was evaluated."""
        return sorted(self._cells.get(cell.key, {}))

    def of(self, cell: "Cell") -> list[Outcome]:
        """The outcomes of a cell, one per seed; none where it was not measured."""
        found = self._cells.get(cell.key, {})
        last = max(found, default=0)
        return found.get(last if cell.iteration is None else cell.iteration, [])


@dataclass(frozen=True)
class Cell:
    """A method on a task's variant, after `iteration` rounds of data (None: the last)."""

    task: str
    variant: str
    method: str
    iteration: int | None = None
    collector: str = "simopt"

    @property
    def key(self) -> tuple[str, ...]:
        return (self.task, self.variant, self.method, self.collector)

    def __str__(self) -> str:
        after = "" if self.iteration is None else f" after {self.iteration}"
        whose = "" if self.collector == "simopt" else f" on {self.collector} data"
        return f"{self.method}{whose} on {self.task} {self.variant}{after}"


Answer = tuple[Verdict, list[str]]
Check = Callable[[Measured], Answer]


def _solves(cell: Cell) -> Check:
    def check(measured: Measured) -> Answer:
        outcomes = measured.of(cell)
        if not outcomes:
            return "not measured", []
        found = interval(returns_of(outcomes), mean, stream("claims"))
        return _beyond(found, _SOLVED), [f"{cell}: {_said(found)}, {_seeds(outcomes)}"]

    return check


def _fails(cell: Cell) -> Check:
    return lambda measured: _not(_solves(cell)(measured))


def _compared(
    ones: Sequence[Cell], others: Sequence[Cell], judge: Callable[[Interval], Verdict]
) -> Check:
    """A judgement of the difference between two methods, averaged over cells."""

    def check(measured: Measured) -> Answer:
        found = [[measured.of(cell) for cell in cells] for cells in (ones, others)]
        if not all(outcomes for side in found for outcomes in side):
            return "not measured", []
        sides = [[returns_of(outcomes) for outcomes in side] for side in found]
        gap = difference(sides[0], sides[1], stream("claims"))
        names = f"{ones[0]} minus {others[0]}"
        if len(ones) > 1:
            names = f"{ones[0].method} minus {others[0].method}, mean of {len(ones)} cells"
        return judge(gap), [f"{names}: {_said(gap)}, {_seeds(found[0][0])}"]

    return check


def _higher(one: Cell, other: Cell) -> Check:
    return _compared([one], [other], lambda gap: _beyond(gap, 0.0))


def _at_least(one: Cell, other: Cell) -> Check:
    return _compared([one], [other], lambda gap: _beyond(gap, -_SAME))


def _equal(one: Cell, other: Cell) -> Check:
    return _compared([one], [other], _within)


def _drops(task: str, variant: str, method: str) -> Check:
    """More target data made the method worse at some iteration, by more than `_SAME`."""

    def check(measured: Measured) -> Answer:
        iterations = measured.iterations(Cell(task, variant, method))
        known = [Cell(task, variant, method, i) for i in iterations if i > 0]
        if len(known) < 2:
            return "not measured", []
        fallen = [
            _compared([a], [b], lambda gap: _beyond(gap, _SAME))(measured)
            for a, b in combinations(known, 2)
        ]
        return _any(fallen)

    return check


def _narrow(cell: Cell) -> Check:
    """The inferred distribution is practically a point."""

    def check(measured: Measured) -> Answer:
        rows = table(measured.of(cell))
        if not rows or rows[0].posterior_std is None:
            return "not measured", []
        std = rows[0].posterior_std
        verdict: Verdict = "supported" if std < _POINT else "contradicted"
        return verdict, [f"{cell}: standard deviation {std:.2g} in [0, 4]"]

    return check


def _costs_more(task: str, dear: str, cheap: str) -> Check:
    """One inference of `dear` simulates more than one of `cheap`, from the same data."""

    def check(measured: Measured) -> Answer:
        cells = [Cell(task, "vanilla", name, 1) for name in (dear, cheap)]
        found = [costs(measured.of(cell)) for cell in cells]
        if not all(found):
            return "not measured", []
        one, other = (side[0].inference_steps for side in found)
        verdict: Verdict = "supported" if one > other else "contradicted"
        return verdict, [f"{task}: {dear} simulates {one:.3g} steps, {cheap} {other:.3g}"]

    return check


def _beyond(found: Interval, bound: float) -> Verdict:
    if found.low >= bound:
        return "supported"
    return "contradicted" if found.high < bound else "undecided"


def _within(gap: Interval) -> Verdict:
    if gap.low >= -_SAME and gap.high <= _SAME:
        return "supported"
    return "contradicted" if gap.low > _SAME or gap.high < -_SAME else "undecided"


def _not(answer: Answer) -> Answer:
    verdict, evidence = answer
    swapped: dict[Verdict, Verdict] = {"supported": "contradicted", "contradicted": "supported"}
    return swapped.get(verdict, verdict), evidence


def _all(answers: Sequence[Answer]) -> Answer:
    """True of all: one contradiction contradicts, one gap leaves it open."""
    verdicts = [verdict for verdict, _ in answers]
    evidence = [line for _, lines in answers for line in lines]
    for verdict in _DECISIVE:
        if verdict in verdicts:
            return verdict, evidence
    return "supported", evidence


def _any(answers: Sequence[Answer]) -> Answer:
    return _not(_all([_not(answer) for answer in answers]))


def _said(found: Interval) -> str:
    return f"{found.value:.2f} [{found.low:.2f}, {found.high:.2f}]"


def _seeds(outcomes: Sequence[Outcome]) -> str:
    return f"{len(outcomes)} seed{'s' if len(outcomes) > 1 else ''}"


@dataclass(frozen=True)
class Claim:
    """A statement that holds if all checks do."""

    name: str
    statement: str
    checks: Sequence[Check]


def _any_of(checks: Sequence[Check]) -> Check:
    return lambda measured: _any([check(measured) for check in checks])


def _all_of(checks: Sequence[Check]) -> Check:
    return lambda measured: _all([check(measured) for check in checks])


def _none_of(checks: Sequence[Check]) -> Check:
    return lambda measured: _not(_any_of(checks)(measured))


def _best_of_all(task: str, variant: str, method: str) -> list[Check]:
    others = [name for name in _METHODS if name != method]
    return [_at_least(Cell(task, variant, method), Cell(task, variant, n)) for n in others]


def _same_whoever_collects(task: str, method: str) -> list[Check]:
    cells = [Cell(task, "noisy", method, None, who) for who in ("simopt", "prior", "random")]
    return [_equal(a, b) for a, b in combinations(cells, 2)]


CLAIMS: tuple[Claim, ...] = (
    Claim(
        "V1",
        "Vanilla: every method transfers on Hopper.",
        [_solves(Cell("hopper", "vanilla", name)) for name in _METHODS],
    ),
    Claim(
        "V2",
        "Vanilla: DROPO solves all four tasks from one trajectory, and equals SimOpt's last.",
        [
            check
            for task in _TASKS
            for check in (
                _solves(Cell(task, "vanilla", "dropo", 1)),
                _equal(Cell(task, "vanilla", "dropo", 1), Cell(task, "vanilla", "simopt")),
            )
        ],
    ),
    Claim(
        "V3",
        "Vanilla: SimOpt improves over iterations, and solves all four tasks.",
        [
            check
            for task in _TASKS
            for check in (
                _solves(Cell(task, "vanilla", "simopt")),
                _higher(Cell(task, "vanilla", "simopt"), Cell(task, "vanilla", "simopt", 0)),
            )
        ],
    ),
    Claim(
        "V4",
        "Vanilla: SimOpt-1 fails on Walker2d.",
        [_fails(Cell("walker2d", "vanilla", "simopt_1"))],
    ),
    Claim(
        "V5",
        "Vanilla: DROID is less stable than SimOpt; on Walker2d more data can make it worse.",
        [
            _drops("walker2d", "vanilla", "droid"),
            _none_of([_drops(task, "vanilla", "simopt") for task in _TASKS]),
        ],
    ),
    Claim(
        "V6",
        "Vanilla: BayRn does not solve HalfCheetah and Walker2d.",
        [_fails(Cell(task, "vanilla", "bayrn")) for task in ("half_cheetah", "walker2d")],
    ),
    Claim(
        "N1",
        "Noisy: all methods still succeed on Hopper.",
        [_solves(Cell("hopper", "noisy", name)) for name in _METHODS],
    ),
    Claim(
        "N2",
        "Noisy: DROID and SimOpt-1 can fail on Walker2d.",
        [_fails(Cell("walker2d", "noisy", name)) for name in ("droid", "simopt_1")],
    ),
    Claim(
        "N3",
        "Noisy: BayRn fails where there are many parameters.",
        [_fails(Cell(task, "noisy", "bayrn")) for task in ("half_cheetah", "walker2d")],
    ),
    Claim(
        "N4",
        "Noisy: SimOpt is lower than in vanilla on hard tasks, and drops on Humanoid after one.",
        [
            *(_higher(Cell(t, "vanilla", "simopt"), Cell(t, "noisy", "simopt")) for t in _HARD),
            _higher(Cell("humanoid", "noisy", "simopt", 1), Cell("humanoid", "noisy", "simopt")),
        ],
    ),
    Claim(
        "N5",
        "Noisy: DROPO transfers everywhere from one trajectory, no worse with more.",
        [
            check
            for task in _TASKS
            for check in (
                _solves(Cell(task, "noisy", "dropo", 1)),
                _at_least(Cell(task, "noisy", "dropo"), Cell(task, "noisy", "dropo", 1)),
            )
        ],
    ),
    Claim(
        "U1",
        "Unmodeled: offline methods behave as in vanilla.",
        [
            _equal(Cell(task, "unmodeled", name), Cell(task, "vanilla", name))
            for task in _TASKS
            for name in ("droid", "dropo")
        ],
    ),
    Claim(
        "U2",
        "Unmodeled: SimOpt and SimOpt-1 fail on Humanoid; SimOpt solves the other three.",
        [
            *(_fails(Cell("humanoid", "unmodeled", name)) for name in ("simopt", "simopt_1")),
            *(_solves(Cell(task, "unmodeled", "simopt")) for task in _TASKS[:3]),
        ],
    ),
    Claim(
        "U3",
        "Unmodeled: BayRn beats the other methods on Hopper.",
        [
            _higher(Cell("hopper", "unmodeled", "bayrn"), Cell("hopper", "unmodeled", name))
            for name in _METHODS
            if name != "bayrn"
        ],
    ),
    Claim(
        "U4",
        "Unmodeled: DROPO is best overall (that epsilon matters is not measured by returns).",
        [check for task in _TASKS for check in _best_of_all(task, "unmodeled", "dropo")],
    ),
    Claim(
        "U5",
        "Unmodeled: DROID ends with almost no variance.",
        [_narrow(Cell(task, "unmodeled", "droid")) for task in _TASKS],
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
            _none_of([_all_of(_same_whoever_collects("walker2d", "droid"))]),
        ],
    ),
    Claim(
        "C1",
        "Cost: DROPO's inference is the dearest, DROID's is cheap (here: simulated steps).",
        [
            _costs_more(task, dear, cheap)
            for task in _TASKS
            for dear, cheap in (("dropo", "simopt"), ("dropo", "droid"), ("simopt", "droid"))
        ],
    ),
    Claim(
        "C2",
        "Offline methods have the better start: DROPO after one trajectory beats SimOpt after one.",
        [_higher(Cell(t, "vanilla", "dropo", 1), Cell(t, "vanilla", "simopt", 1)) for t in _TASKS],
    ),
    Claim(
        "C3",
        "DROPO has the highest average return over tasks and variants.",
        [
            _compared(
                [Cell(t, v, "dropo") for t in _TASKS for v in _VARIANTS],
                [Cell(t, v, name) for t in _TASKS for v in _VARIANTS],
                lambda gap: _beyond(gap, 0.0),
            )
            for name in _METHODS
            if name not in {"dropo", "bayrn"}  # BayRn was not run on Humanoid
        ],
    ),
)

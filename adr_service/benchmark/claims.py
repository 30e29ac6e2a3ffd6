"""What the paper claims, and what the runs at hand say of it.

    for report in reports(outcomes):        # one per budget, such as a preset
        for finding in report.findings:
            print(finding.claim, finding.verdict)

The claims are those of Tiboni et al., "Online vs. Offline Adaptive Domain Randomization
Benchmark", in words. The paper has no numbers that could be compared, and does not say what it
means by "solves", "fails" and "equal"; here: the 95 % interval of the normalised target return
lies above 0.95, lies below it, and the interval of a difference lies within 0.1 of zero. What an
interval does not settle is undecided, and so is everything measured with one seed alone. What
has no interval (widths, costs) must hold for every seed.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from adr_service.benchmark.comparison import Outcome, returns_of, table
from adr_service.benchmark.statistics import Interval, difference, interval, mean
from adr_service.json_values import canonical_json
from adr_service.methods.catalogue import methods
from adr_service.randomness import stream
from adr_service.specs import RunSpec, SimulatedTarget

Verdict = Literal["supported", "contradicted", "undecided", "not measured"]
_SOLVED = 0.95  # normalised target return
_SAME = 0.1  # of a normalised return
_POINT = 0.05  # standard deviation in [0, 4] below which a distribution is a point
_DECISIVE: tuple[Verdict, ...] = ("contradicted", "not measured", "undecided")  # in this order
_METHODS = ("udr", "bayrn", "simopt", "simopt_1", "droid", "dropo")
_HARD = ("half_cheetah", "walker2d", "humanoid")
_TASKS = ("hopper", *_HARD)
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
    """One report per budget. Smoke runs mean nothing, and have none; nor have runs with effects
    beyond the paper's tasks, or with a target that is none of them."""
    budgets: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        spec = outcome.spec
        is_simulated = isinstance(spec.target, SimulatedTarget)
        is_plain = is_simulated and not spec.extension and not spec.hidden_effects
        if is_plain and spec.preset != "smoke" and outcome.iteration.returns:
            budgets.setdefault(canonical_json(_budget(spec)), []).append(outcome)
    return [_report(found) for _, found in sorted(budgets.items())]


def _budget(spec: RunSpec) -> dict[str, object]:
    names = ("preset", "iterations", "transitions", "evaluation_episodes")
    training = {f"training.{k}": v for k, v in spec.training.model_dump().items()}
    return {name: getattr(spec, name) for name in names} | training


def _report(outcomes: Sequence[Outcome]) -> Report:
    spec, measured = outcomes[0].spec, Measured(outcomes)
    plain = RunSpec.model_validate({"task": spec.task, "method": "prior", "preset": spec.preset})
    usual, ours = _budget(plain), _budget(spec)
    findings = [claim.judge(measured) for claim in CLAIMS]
    return Report(spec.preset, {k: v for k, v in ours.items() if usual[k] != v}, findings)


class Measured:
    """The outcomes of one budget, by what was measured.

    A method that was run with several settings counts with those that have the most seeds, of
    several such the latest; of equal runs, the latest.
    """

    def __init__(self, outcomes: Sequence[Outcome]):
        runs: dict[tuple[str, ...], dict[str, dict[int, dict[int, Outcome]]]] = {}
        for outcome in outcomes:
            spec = outcome.spec
            key = (spec.task, spec.variant, spec.method.name, spec.collector)
            simopt = spec.simopt.model_dump() if spec.simopt else None
            settings = canonical_json([spec.method.model_dump(), simopt])
            seeds = runs.setdefault(key, {}).setdefault(settings, {})
            seeds.setdefault(spec.seed, {})[outcome.iteration.iteration] = outcome
        self._cells = {
            key: max(reversed(settings.values()), key=len) for key, settings in runs.items()
        }

    def iterations(self, cell: "Cell") -> list[int]:
        """Those after which every seed of the cell's method was evaluated."""
        seeds = [set(found) for found in self._cells.get(cell.key, {}).values()]
        return sorted(set[int].intersection(*seeds)) if seeds else []

    def of(self, cell: "Cell") -> dict[int, Outcome]:
        """The outcomes of a cell by seed; none where it was not measured."""
        found = self._cells.get(cell.key, {})
        return {
            seed: iterations[self.resolve(cell)]
            for seed, iterations in sorted(found.items())
            if self.resolve(cell) in iterations
        }

    def resolve(self, cell: "Cell") -> int:
        """The iteration that a cell means: the last is the spec's, for methods that iterate."""
        if cell.iteration is not None:
            return cell.iteration
        specs = [o.spec for found in self._cells.get(cell.key, {}).values() for o in found.values()]
        return specs[0].iterations if specs and not methods()[cell.method].is_level else 0


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
        outcomes = list(measured.of(cell).values())
        if not outcomes:
            return "not measured", []
        found = interval(returns_of(outcomes), mean, stream("claims"))
        evidence = [f"{cell}: {_said(found)}, {_seeds(len(outcomes))}"]
        return _by_several(_beyond(found, _SOLVED), len(outcomes)), evidence

    return check


def _fails(cell: Cell) -> Check:
    return lambda measured: _not(_solves(cell)(measured))


def _compared(
    ones: Sequence[Cell], others: Sequence[Cell], judge: Callable[[Interval], Verdict]
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
        return _by_several(judge(gap), seeds), [f"{names}: {_said(gap)}, {_seeds(seeds)}"]

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
        stds = [row.posterior_std for o in measured.of(cell).values() for row in table([o])]
        known = [std for std in stds if std is not None]
        if not known:
            return "not measured", []
        evidence = [f"{cell}: standard deviation {_range(known)} in [0, 4], {_seeds(len(known))}"]
        return _for_every([std < _POINT for std in known]), evidence

    return check


def _costs_more(task: str, dear: str, cheap: str) -> Check:
    """One inference of `dear` simulates more than one of `cheap`, from the same data."""

    def check(measured: Measured) -> Answer:
        one, other = (measured.of(Cell(task, "vanilla", name, 1)) for name in (dear, cheap))
        pairs = [
            (one[seed].iteration.inference_steps, other[seed].iteration.inference_steps)
            for seed in sorted(one.keys() & other.keys())
        ]
        if not pairs:
            return "not measured", []
        said = [_range([float(pair[side]) for pair in pairs]) for side in (0, 1)]
        evidence = f"{task}: {dear} simulates {said[0]} steps, {cheap} {said[1]}"
        return _for_every([a > b for a, b in pairs]), [f"{evidence}, {_seeds(len(pairs))}"]

    return check


def _by_several(verdict: Verdict, seeds: int) -> Verdict:
    """One seed settles nothing, whatever its episodes' interval."""
    return verdict if seeds > 1 else "undecided"


def _for_every(holds: Sequence[bool]) -> Verdict:
    """Of each seed."""
    if all(holds):
        return _by_several("supported", len(holds))
    return "undecided" if any(holds) else _by_several("contradicted", len(holds))


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


def _seeds(count: int) -> str:
    return f"{count} seed{'s' if count > 1 else ''}"


def _range(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.2g}" if low == high else f"{low:.2g} to {high:.2g}"


@dataclass(frozen=True)
class Claim:
    """A statement that holds if all checks do."""

    name: str
    statement: str
    checks: Sequence[Check]

    def judge(self, measured: Measured) -> Finding:
        answers = [check(measured) for check in self.checks]
        return Finding(self.name, self.statement, *_all(answers))


def _any_of(checks: Sequence[Check]) -> Check:
    return lambda measured: _any([check(measured) for check in checks])


def _all_of(checks: Sequence[Check]) -> Check:
    return lambda measured: _all([check(measured) for check in checks])


def _none_of(checks: Sequence[Check]) -> Check:
    return lambda measured: _not(_any_of(checks)(measured))


def _best_of_all(task: str, variant: str, method: str) -> list[Check]:
    # BayRn was not run on Humanoid
    others = [n for n in _METHODS if n != method and (n, task) != ("bayrn", "humanoid")]
    return [_at_least(Cell(task, variant, method), Cell(task, variant, n)) for n in others]


def _cells_of(method: str) -> list[tuple[str, str]]:
    tasks = _TASKS[:3] if method == "bayrn" else _TASKS  # it was not run on Humanoid
    return [(task, variant) for task in tasks for variant in _VARIANTS]


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
        "Vanilla: on Walker2d, more data can make DROID worse, not SimOpt (which is more stable).",
        [
            _drops("walker2d", "vanilla", "droid"),
            _none_of([_drops("walker2d", "vanilla", "simopt")]),
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
        "Unmodeled: no method beats DROPO by more than 0.1 on any task.",
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
        "Offline methods start better: DROPO beats SimOpt after one trajectory.",
        [_higher(Cell(t, "vanilla", "dropo", 1), Cell(t, "vanilla", "simopt", 1)) for t in _TASKS],
    ),
    Claim(
        "C3",
        "DROPO has the highest average return over tasks and variants.",
        [
            _compared(
                [Cell(task, variant, "dropo") for task, variant in _cells_of(name)],
                [Cell(task, variant, name) for task, variant in _cells_of(name)],
                lambda gap: _beyond(gap, 0.0),
            )
            for name in _METHODS
            if name != "dropo"
        ],
    ),
)

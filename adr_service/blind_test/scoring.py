"""Answers of a blind test compared with its key.

    lines = score([Marked(hidden, answer)])
    lines["one effect, ratio 0.3: named"]       # as "9 of 12 = 75 % [43, 95]"

An effect is named if the verdict is `cause` or `tie` and has its kind at its place, alone or in a
tie of three at most (of kinds that may be hidden; others make no tie larger), and nothing that is
not hidden there. A case without an answer counts as wrong in every line.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy import stats

from adr_service.blind_test.cases import RATIOS, Hidden
from adr_service.blind_test.files import Answer, Key
from adr_service.blind_test.sizing import MOST_TIED, may_be_hidden
from adr_service.criticism.verdict import Conclusion
from adr_service.effects.catalogue import get_mechanism

_STRONG = tuple(ratio for ratio in RATIOS if ratio >= 0.3)
_ALL = 10**6
Right = Callable[["Marked"], bool]


@dataclass(frozen=True)
class Marked:
    """A case with its answer, if there is one."""

    hidden: Hidden
    answer: Answer | None


def marked(key: Key, answers: dict[str, Answer]) -> list[Marked]:
    """All cases of a key with the answers to them."""
    return [Marked(hidden, answers.get(name)) for name, hidden in key.cases.items()]


def is_named(case: Marked, most_tied: int = MOST_TIED) -> bool:
    """True if something was named, and each name or one tied with it is hidden there."""
    if case.answer is None or case.answer.verdict not in (Conclusion.CAUSE, Conclusion.TIE):
        return False
    groups, hidden = case.answer.groups(), _hidden(case)
    return all(hidden & set(group) and _size(group) <= most_tied for group in groups)


def _size(group: Sequence[tuple[str, str]]) -> int:
    """Number of tied effects that may be hidden."""
    return sum(may_be_hidden(kind) for kind, _ in group)


def are_all_named(case: Marked) -> bool:
    """True if each hidden effect is named by a cause of its own, and nothing else is."""
    if not is_named(case):
        return False
    assert case.answer is not None
    groups, hidden = case.answer.groups(), sorted(_hidden(case))
    return len(groups) == len(hidden) and any(
        all(effect in group for effect, group in zip(hidden, ordered, strict=True))
        for ordered in permutations(groups)
    )


def has_no_false_second(case: Marked) -> bool:
    """False if a false cause is named beside a right one, or there is no answer."""
    if case.answer is None:
        return False
    hidden = _hidden(case)
    right = [bool(hidden & set(group)) for group in case.answer.groups()]
    return all(right) or not any(right)


def is_silent(case: Marked) -> bool:
    """True if the answer is that nothing is missing."""
    return case.answer is not None and case.answer.verdict == Conclusion.NONE


def is_unknown(case: Marked) -> bool:
    """True if the answer is that something is missing, or left, that is not in the catalogue."""
    return case.answer is not None and (
        case.answer.verdict == Conclusion.UNKNOWN or case.answer.residual.rest == "unknown"
    )


def names_nothing(case: Marked) -> bool:
    return case.answer is not None and not case.answer.causes


def has_no_unknown(case: Marked) -> bool:
    return case.answer is not None and not is_unknown(case)


def _hidden(case: Marked) -> set[tuple[str, str]]:
    return {(effect.kind, effect.location) for effect in case.hidden.effects}


def score(cases: Sequence[Marked]) -> dict[str, str]:
    """Shares with 95 % intervals (Clopper and Pearson), errors of strengths, and cost, by name."""

    def of(kind: str, *ratios: float) -> list[Marked]:
        chosen = [case for case in cases if case.hidden.kind == kind]
        return [case for case in chosen if not ratios or case.hidden.ratio in ratios]

    known = [case for case in cases if case.hidden.kind != "outside"]
    lines: dict[str, str] = {}
    for ratio in RATIOS:
        lines[f"one effect, ratio {ratio:g}: named"] = share(of("one", ratio), is_named)
    strong = f"ratio {_STRONG[0]:g} or above"
    lines[f"one effect, {strong}: named"] = share(of("one", *_STRONG), is_named)
    lines["one effect, all ratios: named"] = share(of("one"), is_named)
    lines["one effect: named, in a tie of any size"] = share(
        of("one"), lambda case: is_named(case, _ALL)
    )
    lines["one effect: none false beside a right one"] = share(of("one"), has_no_false_second)
    lines[f"two effects, {strong}: both named"] = share(of("two", *_STRONG), are_all_named)
    lines["two effects: both named"] = share(of("two"), are_all_named)
    lines["two effects: all that was named is true"] = share(of("two"), is_named)
    lines["nothing hidden: none"] = share(of("none"), is_silent)
    for ratio in RATIOS:
        name = f"outside the catalogue, ratio {ratio:g}: unknown"
        lines[name] = share(of("outside", ratio), is_unknown)
    lines[f"outside the catalogue, {strong}: unknown"] = share(of("outside", *_STRONG), is_unknown)
    lines["outside the catalogue, all ratios: unknown"] = share(of("outside"), is_unknown)
    lines["outside the catalogue: no effect named"] = share(of("outside"), names_nothing)
    lines["in the catalogue, or nothing: not unknown"] = share(known, has_no_unknown)
    lines |= _strengths([case for case in of("one") if is_named(case)])
    return lines | _cost(cases)


def share(cases: Sequence[Marked], right: Right) -> str:
    """Text as "9 of 12 = 75 % [43, 95]"."""
    return _share(sum(map(right, cases)), len(cases))


def _share(count: int, total: int) -> str:
    if not total:
        return "no cases"
    interval = stats.binomtest(count, total).proportion_ci(0.95)
    low, high = (f"{100 * bound:.0f}" for bound in (interval.low, interval.high))
    return f"{count} of {total} = {100 * count / total:.0f} % [{low}, {high}]"


def errors_of(case: Marked) -> tuple[float, bool | None] | None:
    """Relative error of the mechanism's first strength, and whether its interval covers the truth.

    None where the first cause is not the hidden effect itself, or has no estimate; the second is
    None without an interval, or with one that is unbounded on both sides.
    """
    assert case.answer is not None
    first, effect = case.answer.causes[0], case.hidden.effects[0]
    strength = get_mechanism(effect.kind).strengths[0].name
    if (first.kind, first.location) != (effect.kind, effect.location):
        return None
    if (estimate := first.parameters.get(strength)) is None:
        return None
    truth = effect.values[0]
    error = abs(estimate.value / truth - 1)
    if not estimate.has_interval:
        return error, None
    is_above = estimate.low is None or estimate.low <= truth
    return error, is_above and (estimate.high is None or truth <= estimate.high)


def _strengths(right: Sequence[Marked]) -> dict[str, str]:
    judged = [errors for case in right if (errors := errors_of(case)) is not None]
    covered = [covers for _, covers in judged if covers is not None]
    errors = [100 * error for error, _ in judged]
    return {
        "error of the strength, median": (
            f"{np.median(errors):.1f} % of {len(errors)}" if errors else "none given"
        ),
        "95 % intervals that cover the strength": _share(sum(covered), len(covered)),
    }


def _cost(cases: Sequence[Marked]) -> dict[str, str]:
    given = [case.answer for case in cases if case.answer is not None]
    seconds = [answer.cpu_seconds for answer in given if answer.cpu_seconds is not None]
    spread = [f"{value:.1f}" for value in np.percentile(seconds, [25, 50, 75])] if seconds else []
    return {
        "CPU seconds per case, quartiles": ", ".join(spread) or "not given",
        "answered": f"{len(given)} of {len(cases)}",
    }

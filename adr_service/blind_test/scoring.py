"""Answers of a blind test compared with its key.

    lines = score([Marked(hidden, answer)])
    lines["one effect, ratio 0.3: named"]       # as "9 of 12 = 75 % [43, 95]"

An effect is named if the answer has its kind at its place, alone or in a tie of three at most, and
nothing that is not hidden there. A case without an answer counts as wrong in every line.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from adr_service.blind_test.cases import RATIOS, Hidden
from adr_service.blind_test.files import Answer, Key
from adr_service.criticism.verdict import Conclusion

_MOST_TIED = 3
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


def is_named(case: Marked, most_tied: int = _MOST_TIED) -> bool:
    """True if something was named, and each name or one tied with it is hidden there."""
    if case.answer is None or not case.answer.causes:
        return False
    groups, hidden = case.answer.groups(), _hidden(case)
    return all(hidden & set(group) and len(group) <= most_tied for group in groups)


def are_all_named(case: Marked) -> bool:
    """True if each hidden effect is among the names, in ties or not, and nothing else is."""
    if not is_named(case, _ALL):
        return False
    assert case.answer is not None
    return _hidden(case) <= {name for group in case.answer.groups() for name in group}


def is_silent(case: Marked) -> bool:
    """True if the answer is that nothing is missing."""
    return case.answer is not None and case.answer.verdict == Conclusion.NONE


def is_unknown(case: Marked) -> bool:
    """True if the answer is that something is missing, or left, that is not in the catalogue."""
    return case.answer is not None and (
        case.answer.verdict == Conclusion.UNKNOWN or case.answer.residual.rest == "unknown"
    )


def has_no_unknown(case: Marked) -> bool:
    return case.answer is not None and not is_unknown(case)


def _hidden(case: Marked) -> set[tuple[str, str]]:
    return {(effect.kind, effect.location) for effect in case.hidden.effects}


def score(cases: Sequence[Marked]) -> dict[str, str]:
    """Shares with 95 % intervals (Clopper and Pearson), errors of strengths, and cost, by name."""

    def of(kind: str, ratio: float | None = None) -> list[Marked]:
        chosen = [case for case in cases if case.hidden.kind == kind]
        return [case for case in chosen if ratio is None or case.hidden.ratio == ratio]

    known = [case for case in cases if case.hidden.kind != "outside"]
    lines: dict[str, str] = {}
    for ratio in RATIOS:
        lines[f"one effect, ratio {ratio:g}: named"] = share(of("one", ratio), is_named)
    lines["one effect: named, in a tie of any size"] = share(
        of("one"), lambda case: is_named(case, _ALL)
    )
    lines["two effects: both named"] = share(of("two"), are_all_named)
    lines["two effects: all that was named is true"] = share(of("two"), is_named)
    lines["nothing hidden: none"] = share(of("none"), is_silent)
    for ratio in RATIOS:
        name = f"outside the catalogue, ratio {ratio:g}: unknown"
        lines[name] = share(of("outside", ratio), is_unknown)
    lines["in the catalogue, or nothing: not unknown"] = share(known, has_no_unknown)
    lines |= _strengths([case for case in of("one") if is_named(case)])
    return lines | _cost(cases)


def share(cases: Sequence[Marked], right: Right) -> str:
    """Text as "9 of 12 = 75 % [43, 95]"."""
    if not cases:
        return "no cases"
    count = sum(map(right, cases))
    interval = stats.binomtest(count, len(cases)).proportion_ci(0.95)
    low, high = (f"{100 * bound:.0f}" for bound in (interval.low, interval.high))
    return f"{count} of {len(cases)} = {100 * count / len(cases):.0f} % [{low}, {high}]"


def errors_of(case: Marked) -> tuple[float, bool | None] | None:
    """Relative error of the first strength, and whether its interval covers the truth.

    None where the first cause is not the hidden effect itself, or has no estimate; the second is
    None without an interval.
    """
    assert case.answer is not None
    first, effect = case.answer.causes[0], case.hidden.effects[0]
    if (first.kind, first.location) != (effect.kind, effect.location) or not first.parameters:
        return None
    estimate, truth = next(iter(first.parameters.values())), effect.values[0]
    error = abs(estimate.value / truth - 1)
    if not estimate.has_interval:
        return error, None
    is_above = estimate.low is None or estimate.low <= truth
    return error, is_above and (estimate.high is None or truth <= estimate.high)


def _strengths(right: Sequence[Marked]) -> dict[str, str]:
    judged = [errors for case in right if (errors := errors_of(case)) is not None]
    covered = [covers for _, covers in judged if covers is not None]
    median = f"{100 * np.median([error for error, _ in judged]):.1f} %" if judged else "none given"
    return {
        "error of the strength, median": median,
        "95 % intervals that cover the strength": (
            f"{sum(covered)} of {len(covered)}" if covered else "none given"
        ),
    }


def _cost(cases: Sequence[Marked]) -> dict[str, str]:
    given = [case.answer for case in cases if case.answer is not None]
    seconds = [answer.cpu_seconds for answer in given if answer.cpu_seconds is not None]
    spread = [f"{value:.1f}" for value in np.percentile(seconds, [25, 50, 75])] if seconds else []
    return {
        "CPU seconds per case, quartiles": ", ".join(spread) or "not given",
        "answered": f"{len(given)} of {len(cases)}",
    }

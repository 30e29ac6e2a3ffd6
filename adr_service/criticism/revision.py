"""Named effects in the light of each other.

    named, current = reconsidered(named, current, range(len(named)), responses, rng, alive)
    named, current = narrowed(*pruned(named, current))
    named, current, gone = determined(named, current)

What explained most before the others were known may be another's stand-in, superfluous now, or a
group, though a few of its places suffice. Its strength may also be too unsure to be anything.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.decision import THRESHOLD, TIE, is_evidence
from adr_service.criticism.evidence import gained, held_out_where, held_out_without
from adr_service.criticism.fits import Fit, refine
from adr_service.criticism.intervals import may_be_nothing
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import scan
from adr_service.criticism.weighing import (
    Alike,
    close_to_best,
    from_elsewhere,
    missed,
    parts,
    single_places,
    slots,
    weigh,
)
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import is_part

_SIGNIFICANT = 3.0  # standard deviations of a strength
_PAIR = 2  # places that are two causes rather than a group of three
_CLEARLY = 20.0  # thresholds that a loss exceeds by linearisation, if no refinement need confirm it


def reconsidered(
    named: Sequence[Alike],
    current: Fit,
    which: range,
    responses: Responses,
    rng: np.random.Generator,
    alive: Callable[[], None],
) -> tuple[list[Alike], Fit]:
    """Some of the named effects weighed again beside all others, and the fit: what explained most
    before these were known may stand in for something else.

    One is replaced, and becomes the last, if something else beats it, or explains as much with
    fewer strengths. Groups without a tie are not asked.
    """
    kept, number = list(named), which.start
    for _ in which:
        slot = slots(kept)[number]
        before, own = kept[number], current.effects[slot]
        is_asked = len(own) == 1 or len(before) > 1
        rest = _without(range(slot.start, slot.stop), current) if is_asked else None
        asked = [] if rest is None else _rivals(rest, before, own, responses)
        again: Alike = ()
        if rest is not None and max(len(before), len(asked)) > 1:
            again = weigh(rest, asked, rng, alive)[0]
        staying = [each for each in again if parts(each.effects) == parts(own)]
        if rest is None or not again or (staying and staying[0].size <= again[0].size):
            kept[number] = (
                *staying,
                *(each for each in again if parts(each.effects) != parts(own)),
            ) or before
            number += 1
        else:
            kept = [*kept[:number], *kept[number + 1 :], again]
            current = smoothed(from_elsewhere(rest, again[0].fit))
    return kept, current


def _rivals(
    rest: Fit, alike: Alike, own: tuple[Effect, ...], responses: Responses
) -> list[tuple[Effect, ...]]:
    """A named effect, what was tied with it and, for a single one, what explains about as much now
    by the scan of a fit with all others."""
    taken = parts(rest.effects)
    asked = [own, *(other.newest for other in alike[1:] if not parts(other.newest) & taken)]
    if len(own) > 1:
        return asked
    known = set().union(*map(parts, asked))
    close = close_to_best(single_places(scan(rest, responses)))
    return [*asked, *(each.effects for each in close if not parts(each.effects) & known)]


def pruned(named: list[Alike], current: Fit) -> tuple[list[Alike], Fit]:
    """The named effects without those that the others make superfluous."""
    while len(named) > 1:
        whole = held_out_without(current, ())
        shorter = {
            number: rest
            for number, slot in enumerate(slots(named))
            if not _are_clearly_missed(own := range(slot.start, slot.stop), whole, current)
            and (rest := _without(own, current)) is not None
        }
        if not shorter:
            break
        settled = current.settled
        here = held_out_where(settled.persistence, settled)
        losses = {
            number: here - held_out_where(settled.persistence, rest)
            for number, rest in shorter.items()
        }
        superfluous = [number for number, loss in losses.items() if not is_evidence(loss)]
        if not superfluous:
            break
        least = min(superfluous, key=lambda number: losses[number].sum())
        named = [alike for number, alike in enumerate(named) if number != least]
        current = smoothed(shorter[least])
    return named, current


def determined(named: list[Alike], current: Fit) -> tuple[list[Alike], Fit, tuple[Effect, ...]]:
    """The named effects without those that the data do not tell from nothing, by the intervals of
    their strengths, then the fit, and these effects.

    The least of them goes first: what it was confused with may be determined without it. One
    without which nothing can be simulated stays.
    """
    gone: tuple[Effect, ...] = ()
    while (found := _least_determined(named, current)) is not None:
        number, rest = found
        gone = (*gone, *current.effects[slots(named)[number]])
        named = [*named[:number], *named[number + 1 :]]
        current = smoothed(rest)
    return named, current, gone


def _least_determined(named: Sequence[Alike], current: Fit) -> tuple[int, Fit] | None:
    """Position of the least of the named effects that may be nothing, and the fit without it."""
    at = slots(named)
    unsure = [number for number, slot in enumerate(at) if may_be_nothing(current, slot)]
    for number in sorted(unsure, key=lambda number: named[number][0].gain):
        rest = _without(range(at[number].start, at[number].stop), current)
        if rest is not None:
            return number, rest
    return None


def _without(gone: Sequence[int], current: Fit) -> Fit | None:
    """The fit without the effects of these numbers.

    An effect that includes one of them may take over its strength: beside it, its own may be zero,
    because the data do not tell the two apart.
    """
    lost = [current.effects[number] for number in gone]
    rest = [effect for n, effect in enumerate(current.effects) if n not in gone]
    whole = [_in_place_of(lost, effect) for effect in rest]
    starts = [rest] if whole == rest else [rest, whole]
    found = [each for each in (refine(current, start) for start in starts) if each is not None]
    return max(found, key=lambda each: each.held_out.sum(), default=None)


def _in_place_of(lost: Sequence[Effect], effect: Effect) -> Effect:
    """An effect with the strengths of those that it includes added to its own."""
    values = np.array(effect.values)
    for other in lost:
        if is_part(other, effect):
            values[: len(other.values)] += other.values
    return replace(effect, values=tuple(values.tolist()))


def _are_clearly_missed(numbers: Sequence[int], whole: Vector, current: Fit) -> bool:
    """True if a fit without some effects is, linearised, so much worse than the `whole` (E,) that
    refining it, which takes many simulations, would not tell otherwise.

    A linear fit cannot tell where another effect includes one of them.
    """
    if any(is_part(current.effects[n], other) for n in numbers for other in current.effects):
        return False
    loss = whole - held_out_without(current, numbers)
    return is_evidence(loss) and float(loss.sum()) > _CLEARLY * THRESHOLD


def narrowed(named: Sequence[Alike], current: Fit) -> tuple[list[Alike], Fit]:
    """The named effects with a few places instead of a group that needs no others, now that all
    are known."""
    if all(len(alike[0].effects) == 1 for alike in named):
        return list(named), current
    kept: list[Alike] = []
    whole = held_out_without(current, ())
    for number, alike in enumerate(named):
        slot = slots([*kept, *named[number:]])[len(kept)]
        is_group = len(alike[0].effects) > 1
        few = _few_places(current, slot, whole) if is_group else None
        if few is None:
            kept.append(alike)
            continue
        gone = len(current.effects) - len(few.effects)
        current = smoothed(few)
        whole = held_out_without(current, ())
        kept += _apart(alike, current, range(slot.start, slot.stop - gone), whole)
    return kept, current


def _few_places(current: Fit, slot: slice, whole: Vector) -> Fit | None:
    """The fit with the most significant place of a group, if there is no evidence for the others,
    or with its significant ones (half of them at most, or two), if the others explain nothing; None
    if they would be missed. `whole` (E,): log-likelihood with all, linearised."""
    significance = {
        number: _significance(current, number) for number in range(slot.start, slot.stop)
    }
    order = sorted(significance, key=lambda number: -significance[number])
    strong = sum(value > _SIGNIFICANT for value in significance.values())
    for count in sorted({1, strong}):
        gone = order[count:]
        is_few = 0 < count < len(order) and count <= max(_PAIR, len(order) // 2)
        if not is_few or _are_clearly_missed(gone, whole, current):
            continue
        few = _without(gone, current)
        if few is None:
            continue
        loss = gained(current.settled, few)
        if loss.sum() < TIE or (count == 1 and not is_evidence(loss)):
            return few
    return None


def _apart(alike: Alike, current: Fit, numbers: Sequence[int], whole: Vector) -> list[Alike]:
    """The places of a group that are left in a fit, as causes of their own; one alone is tied with
    the places that its group was tied with."""
    group, *others = alike
    apart = [missed(group, [number], current, whole) for number in numbers]
    if len(apart) > 1:
        return [(each,) for each in apart]
    known = parts(apart[0].effects)
    single = (each for each in others if len(each.effects) == 1)
    return [(apart[0], *(each for each in single if not parts(each.effects) & known))]


def _significance(fit: Fit, number: int) -> float:
    """First strength of one of a fit's effects, in standard deviations."""
    column = fit.columns_of(slice(number, number + 1)).start
    deviation = np.sqrt(fit.normal.change()[1][column, column])
    return abs(fit.effects[number].values[0]) / float(deviation) if deviation > 0 else 0.0

"""The search for the effects that a simulator lacks, one after the other.

    named, final, chance = name_effects(
        baseline, candidates, responses, block, sensor, rng, progress
    )
    named, final = narrowed(*pruned(named, final, sensor), sensor)

Each is named on its own evidence beside those named before, and dropped again if the others make
it superfluous.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.decision import (
    ALIKE,
    THRESHOLD,
    TIE,
    Decision,
    beats,
    decide,
    is_evidence,
)
from adr_service.criticism.evidence import Fit, held_out_without, refine, settled, smoothed
from adr_service.criticism.inverse import Group
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import Candidate, scan
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import sensible
from adr_service.progress import Progress

_REFINED, _CLOSE, _MOST_REFINED = 6, 0.9, 10
_GROUPS_REFINED = 2
_OTHER_STARTS = (0.5, 2.0)  # times the estimated strengths
_PROMISING = THRESHOLD / 4  # [nats] by the scan; refining adds little more
_MOST_NAMED = 8
# A block must gain this much more than the best candidate alone: times that candidate's gain, or
# nats by reading (exp(-.5): errors are two fifths smaller), whichever is less.
_FAR, _CLOSER = 2.0, 0.5
_CLEARLY = 20.0  # thresholds that a loss exceeds by linearisation, if no refinement need confirm it


@dataclass(frozen=True)
class Weighed:
    """A candidate as the newest effect of a fit, and the evidence for it."""

    effects: tuple[Effect, ...]  # as they were tried: one, or a group
    fit: Fit
    gains: Vector  # (E,) nats
    confidence: float

    @property
    def gain(self) -> float:
        return float(self.gains.sum())

    @property
    def fair_gain(self) -> float:
        """Gain after a group's handicap: it must beat the best single place by the threshold of
        evidence."""
        return self.gain - THRESHOLD * (len(self.effects) > 1)

    @property
    def newest(self) -> tuple[Effect, ...]:
        """The effects with the strengths that they have in the fit."""
        return self.fit.effects[len(self.fit.effects) - len(self.effects) :]


@dataclass(frozen=True)
class Block:
    """Effects that supply the forces which the motion needs, as predictions judge them."""

    groups: tuple[Group, ...]  # with their strengths in the fit
    fit: Fit
    gains: Vector  # (E,) nats of all together

    @property
    def fair_gain(self) -> float:
        """Gain after a handicap for every group."""
        return float(self.gains.sum()) - THRESHOLD * len(self.groups)


def block_of(start: Fit, groups: Sequence[Group], sensor: Vector) -> Block | None:
    """The groups together in a fit; None if there are none, or nothing can be simulated."""
    effects = [effect for group in groups for effect in group]
    refined = refine(start, effects, sensor) if groups else None
    if refined is None:
        return None
    found = iter(refined.effects)
    strong = tuple(tuple(next(found) for _ in group) for group in groups)
    return Block(strong, refined, refined.held_out - start.held_out)


Alike = tuple[Weighed, ...]  # the best candidate, then all that explain as much


def name_effects(
    baseline: Fit,
    candidates: Sequence[Candidate],
    responses: Responses,
    block: Block | None,
    sensor: Vector,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[Alike], Fit, float]:
    """The effects with evidence, the fit with all of them, and the probability that the next one
    would be chance.

    `block`: effects to begin with, if they are far better together than any candidate alone.
    """
    named: list[Alike] = []
    current, chance = baseline, 1.0
    if block is not None and _is_far_better(block, baseline, candidates[:_REFINED], sensor):
        named, current = _standing(block, sensor, rng)
        responses, chance = Responses(current), 0.0  # about the baseline all would be others
    for count in range(len(named), _MOST_NAMED):
        done = 0.1 + 0.7 * count / _MOST_NAMED
        progress(done, causes=count)
        if count > 0:
            candidates = scan(current, responses)
        decision, weighed = _weigh(current, candidates, sensor, rng, partial(progress, done))
        chance = float(decision.confidence[-1])
        if not decision.alike:
            break
        named.append(_simplest_first([weighed[number] for number in decision.alike]))
        current = smoothed(from_elsewhere(current, named[-1][0].fit, sensor), sensor)
    return named, current, chance


def _is_far_better(block: Block, baseline: Fit, best: Sequence[Candidate], sensor: Vector) -> bool:
    """True if a block leaves much less than the best candidate does alone, refined.

    What could be two causes or three is left to the search, which looks beyond forces.
    """
    most = THRESHOLD
    without = settled(baseline, sensor).held_out
    for candidate in best:
        refined = refine(baseline, candidate.effects, sensor)
        if refined is not None:
            most = max(most, float((refined.held_out - without).sum()))
            break
    readings = int(baseline.linear.chain.mask.sum()) * baseline.linear.residual.shape[2]
    return block.fair_gain - most > min(_FAR * most, _CLOSER * readings)


def _standing(block: Block, sensor: Vector, rng: np.random.Generator) -> tuple[list[Alike], Fit]:
    """The groups of a block that the others do not make superfluous, each with what these explain
    less alone, and the fit."""
    whole: list[Alike] = [(Weighed(group, block.fit, block.gains, 0.0),) for group in block.groups]
    kept, current = pruned(whole, smoothed(block.fit, sensor), sensor)
    everything = held_out_without(current, (), sensor)
    named: list[Alike] = []
    for slot, (weighed,) in zip(slots(kept), kept, strict=True):
        gains = everything - held_out_without(current, _numbers(slot), sensor)
        confidence = float(decide(gains[None], rng).confidence[0])
        named.append((replace(weighed, fit=current, gains=gains, confidence=confidence),))
    return named, current


def _weigh(
    current: Fit,
    candidates: Sequence[Candidate],
    sensor: Vector,
    rng: np.random.Generator,
    alive: Callable[[], None],
) -> tuple[Decision, list[Weighed]]:
    """The evidence for the best candidates, refined; `alive` is called before each."""
    without = settled(current, sensor).held_out
    weighed: list[Weighed] = []
    for candidate in _worth_refining(candidates):
        alive()
        refined = refine(current, [*current.effects, *candidate.effects], sensor)
        if refined is not None:
            gains = refined.held_out - without
            weighed.append(Weighed(candidate.effects, refined, gains, 0.0))
    fair = [each.gains + (each.fair_gain - each.gain) / len(without) for each in weighed]
    decision = decide(np.reshape(fair, (len(weighed), len(without))), rng)
    likely = decision.confidence[:-1].tolist()
    return decision, [replace(w, confidence=p) for w, p in zip(weighed, likely, strict=True)]


def _worth_refining(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates to refine: the best single ones, all that come close to the best up to
    `_MOST_REFINED`, and groups that beat it."""
    single = [c for c in candidates if len(c.effects) == 1 and c.gain > _PROMISING]
    best = single[0].gain if single else 0.0
    close = [c for c in single if c.gain > _CLOSE * best]
    chosen = max(single[:_REFINED], close, key=len)[:_MOST_REFINED]
    groups = [c for c in candidates if len(c.effects) > 1 and c.gain > best + THRESHOLD]
    return [*chosen, *groups[:_GROUPS_REFINED]]


def _simplest_first(alike: Sequence[Weighed]) -> Alike:
    """Indistinguishable candidates, one with the fewest strengths first, then the best; without
    those that are the first with a strength more."""
    best = max(each.fair_gain for each in alike)
    near = [each for each in alike if best - each.fair_gain < max(TIE, ALIKE * best)]
    first = min(near, key=lambda each: (sum(len(e.values) for e in each.effects), -each.fair_gain))
    known = _parts(first.effects)
    others = [each for each in alike if each is first or not known <= _included(each.effects)]
    return (first, *(each for each in others if each is not first))


def _included(effects: Sequence[Effect]) -> set[tuple[str, str]]:
    return {(get_mechanism(effect.kind).includes, effect.location) for effect in effects}


def from_elsewhere(current: Fit, best: Fit, sensor: Vector) -> Fit:
    """The best of a fit with newer effects, and of fits from other strengths of those."""
    newest = best.effects[len(current.effects) :]
    starts = [
        [sensible(e, factor * np.array(e.values)) for e in newest] for factor in _OTHER_STARTS
    ]
    others = (refine(current, [*current.effects, *start], sensor) for start in starts)
    fits = [best, *(other for other in others if other is not None)]
    return max(fits, key=lambda fit: fit.held_out.sum())


def slots(named: Sequence[Alike]) -> list[slice]:
    """Positions, among the effects of a fit, of each that was named."""
    ends = np.cumsum([len(alike[0].effects) for alike in named]).tolist()
    return [slice(e - len(a[0].effects), e) for e, a in zip(ends, named, strict=True)]


def pruned(named: list[Alike], current: Fit, sensor: Vector) -> tuple[list[Alike], Fit]:
    """The named effects without those that the others make superfluous."""
    while len(named) > 1:
        everything = settled(current, sensor).held_out
        linearised = held_out_without(current, (), sensor)
        shorter = {
            number: _without(slot, current, sensor)
            for number, slot in enumerate(slots(named))
            if not _are_clearly_missed(_numbers(slot), linearised, current, sensor)
        }
        rests = {
            number: rest
            for number, rest in shorter.items()
            if rest is not None and not is_evidence(everything - rest.held_out)
        }
        if not rests:
            break
        least, rest = max(rests.items(), key=lambda entry: entry[1].held_out.sum())
        named = [alike for number, alike in enumerate(named) if number != least]
        current = smoothed(rest, sensor)
    return named, current


def _without(slot: slice, current: Fit, sensor: Vector) -> Fit | None:
    """The fit without some of its effects."""
    return refine(current, [*current.effects[: slot.start], *current.effects[slot.stop :]], sensor)


def _are_clearly_missed(
    numbers: Sequence[int], linearised: Vector, current: Fit, sensor: Vector
) -> bool:
    """True if a fit without some effects is so much worse than with all, both `linearised`, that
    refining it, which takes many simulations, would not tell otherwise."""
    loss = linearised - held_out_without(current, numbers, sensor)
    return is_evidence(loss) and float(loss.sum()) > _CLEARLY * THRESHOLD


def _numbers(slot: slice) -> Sequence[int]:
    return range(slot.start, slot.stop)


def narrowed(named: Sequence[Alike], current: Fit, sensor: Vector) -> tuple[list[Alike], Fit]:
    """The named effects with one place instead of a group that needs no other, now that all are
    known."""
    kept = list(named)
    for number, alike in enumerate(named):
        if len(named) == 1 or len(alike[0].effects) == 1:
            continue
        single = _single(alike, current, slots(kept)[number], sensor)
        if single is not None:
            kept[number] = single
            current = smoothed(single[0].fit, sensor)
    return kept, current


def _single(alike: Alike, current: Fit, slot: slice, sensor: Vector) -> Alike | None:
    """The most significant place of a group in its stead; None if the group has evidence beside
    it."""
    group, *others = alike
    before, after = current.effects[: slot.start], current.effects[slot.stop :]
    alone = max(current.effects[slot], key=lambda effect: _significance(current, effect))
    elsewhere = [n for n in _numbers(slot) if current.effects[n] is not alone]
    linearised = held_out_without(current, (), sensor)
    if _are_clearly_missed(elsewhere, linearised, current, sensor):
        return None
    rest = refine(current, [*before, alone, *after], sensor)
    if rest is None or is_evidence(settled(current, sensor).held_out - rest.held_out):
        return None
    single = [o for o in others if len(o.effects) == 1 and not _parts(o.effects) & _parts([alone])]
    without = refine(current, [*before, *after], sensor)
    gains = group.gains if without is None else rest.held_out - without.held_out
    return (replace(group, effects=(alone,), fit=rest, gains=gains), *single)


def _significance(fit: Fit, effect: Effect) -> float:
    """First strength of one of a fit's effects, in standard deviations."""
    number = fit.effects.index(effect)
    column = fit.columns_of(slice(number, number + 1)).start
    deviation = np.sqrt(fit.normal.change()[1][column, column])
    return abs(effect.values[0]) / float(deviation) if deviation > 0 else 0.0


def still_tied(named: list[Alike], final: Fit, sensor: Vector) -> list[Alike]:
    """The named effects without alternatives that do worse now that all effects are known."""
    if len(named) < 2:
        return named
    everything, left = settled(final, sensor).held_out, []
    for slot, (best, *others) in zip(slots(named), named, strict=True):
        before, after = final.effects[: slot.start], final.effects[slot.stop :]
        kept: list[Weighed] = []
        for other in others:
            if _parts(other.newest) & _parts([*before, *after]):  # named elsewhere
                continue
            instead = refine(final, [*before, *other.newest, *after], sensor)
            if instead is not None and not beats(everything - instead.held_out, best.gain):
                kept.append(other)
        left.append((best, *kept))
    return left


def _parts(effects: Sequence[Effect]) -> set[tuple[str, str]]:
    return {(effect.kind, effect.location) for effect in effects}

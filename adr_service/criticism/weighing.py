"""Evidence for effects and groups beside a fit, and what explains as much as the best of them.

    alike, chance = weigh(current, asked, rng, alive)
    alike[0].effects, alike[0].gain         # the best; the others are tied with it

`asked` are effects, or groups of one kind at several places, each with a strength to start from.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.decision import ALIKE, THRESHOLD, TIE, decide
from adr_service.criticism.evidence import held_out_where, held_out_without
from adr_service.criticism.fits import Fit, improved, refine, tried
from adr_service.criticism.scan import Candidate
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import is_part
from adr_service.effects.models import sensible, shapes_of

_PROMISING = THRESHOLD / 4  # [nats]; refining adds little more
_CLOSE, _MOST_REFINED = 0.9, 10  # of the best gain; candidates
_HOPEFUL = 0.4  # of the best gain at a first look; steps to better strengths add to it
_OTHER_STARTS = (0.5, 2.0)  # times the estimated strengths


@dataclass(frozen=True)
class Weighed:
    """A candidate as the newest effect of a fit, and the evidence for it."""

    effects: tuple[Effect, ...]  # as they were asked: one, or a group
    fit: Fit
    gains: Vector  # (E,) nats
    confidence: float

    @property
    def gain(self) -> float:
        return float(self.gains.sum())

    @property
    def size(self) -> int:
        """Number of strengths."""
        return sum(len(effect.values) for effect in self.effects)

    @property
    def fair_gain(self) -> float:
        """Gain after a group's handicap: it must beat the best single place by the threshold of
        evidence."""
        return self.gain - THRESHOLD * (len(self.effects) > 1)

    @property
    def newest(self) -> tuple[Effect, ...]:
        """The effects with the strengths that they have in the fit."""
        return self.fit.effects[len(self.fit.effects) - len(self.effects) :]


Alike = tuple[Weighed, ...]  # the best candidate, then all that explain as much


def single_places(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates of one place that are worth a look, the best first."""
    return [c for c in candidates if len(c.effects) == 1 and c.gain > _PROMISING]


def close_to_best(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates, the best first, that come close to it; not too many to refine."""
    return [c for c in candidates if c.gain > _CLOSE * candidates[0].gain][:_MOST_REFINED]


def weigh(
    current: Fit,
    asked: Sequence[Sequence[Effect]],
    rng: np.random.Generator,
    alive: Callable[[], None],
) -> tuple[Alike, float]:
    """The best of effects or groups beside a fit's, with all that explain as much (none without
    evidence), and the probability that it is chance; `alive` is called before each.

    Those that a first look shows far below the best are left out, unless they act at its places.
    If the best one stays below `_PROMISING` after refinement, no other is refined.
    """
    without = current.settled.held_out
    looks: list[Weighed] = []
    for effects in asked:
        alive()
        first = _first_look(current, effects, without)
        if first is not None:
            looks.append(first)
    weighed = _beside_persistence(_hopeful_at_best(looks, current, without, alive), current)
    fair = [each.gains + (each.fair_gain - each.gain) / len(without) for each in weighed]
    decision = decide(np.reshape(fair, (len(weighed), len(without))), rng)
    *likely, chance = decision.confidence.tolist()
    alike = [replace(weighed[number], confidence=likely[number]) for number in decision.alike]
    return _simplest_first(alike), chance


def _first_look(current: Fit, effects: Sequence[Effect], without: Vector) -> Weighed | None:
    """Effects at the strengths that they have or, where these are no evidence, at half of them if
    that is likelier: near a contact the linear estimate is often too strong. None: they cannot be
    simulated."""
    first: Weighed | None = None
    for factor in (1.0, 0.5):
        fit = tried(current, [*current.effects, *_times(effects, factor)])
        if fit is not None and (first is None or fit.held_out.sum() > first.fit.held_out.sum()):
            first = Weighed(tuple(effects), fit, fit.held_out - without, 0.0)
        if first is not None and first.gain > THRESHOLD:
            break
    return first


def _hopeful_at_best(
    looks: Sequence[Weighed], current: Fit, without: Vector, alive: Callable[[], None]
) -> list[Weighed]:
    """Looks that may turn out best, after steps to better strengths.

    Among them is all that acts at the best one's places, however little it explains at first: near
    a contact its first strength may be a quarter of the one at which it explains most.
    """
    if not looks:
        return []
    best = max(looks, key=lambda look: look.fair_gain)
    first = _at_best(best, current, without, alive)
    if max(best.fair_gain, first.fair_gain) < _PROMISING:
        return [first]
    least, places = min(best.fair_gain, _HOPEFUL * best.fair_gain), _places(best)
    return [
        first if look is best else _at_best(look, current, without, alive)
        for look in looks
        if look.fair_gain >= least or _places(look) == places
    ]


def _places(look: Weighed) -> set[str]:
    return {effect.location for effect in look.effects}


def _at_best(look: Weighed, current: Fit, without: Vector, alive: Callable[[], None]) -> Weighed:
    alive()
    fit = improved(current, look.fit)
    return replace(look, fit=fit, gains=fit.held_out - without)


def _beside_persistence(weighed: list[Weighed], current: Fit) -> list[Weighed]:
    """Candidates with their gains where misfit persists as it does beside the best of them."""
    best = max(weighed, key=lambda each: each.fair_gain, default=None)
    if best is None or best.fit.persistence.share == 0:
        return weighed
    persistence = best.fit.persistence
    without = held_out_where(persistence, current.settled)
    return [
        replace(each, gains=held_out_where(persistence, each.fit) - without) for each in weighed
    ]


def _simplest_first(alike: Sequence[Weighed]) -> Alike:
    """Indistinguishable candidates, one with the fewest strengths first, then the best; those that
    are the first with a strength more add their confidence to it."""
    if not alike:
        return ()
    best = max(each.fair_gain for each in alike)
    near = [each for each in alike if best - each.fair_gain < max(TIE, ALIKE * best)]
    first = min(near, key=lambda each: (each.size, -each.fair_gain))
    is_same = [each is first or _is_part(first.effects, each.effects) for each in alike]
    both = list(zip(alike, is_same, strict=True))
    confidence = sum(each.confidence for each, same in both if same)
    return (replace(first, confidence=confidence), *(each for each, same in both if not same))


def _is_part(some: Sequence[Effect], whole: Sequence[Effect]) -> bool:
    """True if each of some effects is part of one of the others."""
    return all(any(is_part(one, other) for other in whole) for one in some)


def from_elsewhere(current: Fit, best: Fit) -> Fit:
    """The best of a fit with newer effects, and of fits from other strengths of those."""
    newest = best.effects[len(current.effects) :]
    starts = [_times(newest, factor) for factor in _OTHER_STARTS]
    others = (refine(current, [*current.effects, *start]) for start in starts)
    fits = [best, *(other for other in others if other is not None)]
    return max(fits, key=lambda fit: fit.held_out.sum())


def _times(effects: Sequence[Effect], factor: float) -> list[Effect]:
    """Effects with so many times their strengths, as far as these make sense."""
    return [sensible(e, np.where(shapes_of(e.kind), 1.0, factor) * e.values) for e in effects]


def missed(weighed: Weighed, numbers: Sequence[int], current: Fit, whole: Vector) -> Weighed:
    """Some of a fit's effects, with what the others explain less (of `whole`) without them."""
    gains = whole - held_out_without(current, numbers)
    effects = tuple(current.effects[number] for number in numbers)
    return replace(weighed, effects=effects, fit=current, gains=gains)


def slots(named: Sequence[Alike]) -> list[slice]:
    """Positions, among the effects of a fit, of each that was named."""
    ends = np.cumsum([len(alike[0].effects) for alike in named]).tolist()
    return [slice(e - len(a[0].effects), e) for e, a in zip(ends, named, strict=True)]


def parts(effects: Sequence[Effect]) -> set[tuple[str, str]]:
    return {(effect.kind, effect.location) for effect in effects}

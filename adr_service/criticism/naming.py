"""The search for the effects that a simulator lacks, one after the other.

    named, final, chance = name_effects(
        baseline, candidates, responses, block, rng, progress
    )

Each is named on its own evidence beside those named before, weighed again when later ones are
known, and dropped if the others make it superfluous.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.decision import THRESHOLD, decide, is_evidence
from adr_service.criticism.evidence import held_out_without
from adr_service.criticism.fits import Fit, improved, refine, tried
from adr_service.criticism.inverse import Group
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.responses import Responses
from adr_service.criticism.revision import narrowed, pruned, reconsidered
from adr_service.criticism.scan import Candidate, scan
from adr_service.criticism.steps import in_finer_steps
from adr_service.criticism.weighing import (
    Alike,
    Weighed,
    close_to_best,
    from_elsewhere,
    missed,
    single_places,
    slots,
    weigh,
)
from adr_service.progress import Progress

_REFINED, _GROUPS_REFINED = 6, 2
_MOST_NAMED, _REVISIONS = 8, 3
# A block must gain this much more than the best candidate alone: times that candidate's gain, or
# nats by reading (exp(-.5): errors are two fifths smaller), whichever is less.
_FAR, _CLOSER = 2.0, 0.5


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


def block_of(start: Fit, groups: Sequence[Group]) -> Block | None:
    """The groups together in a fit.

    None if there are none, if the simulation diverges, or if left-out episodes are no likelier
    with them than without, after one linear step. Where a robot touches the ground, inverse
    dynamics asks for loads and springs that are far too large: on one HalfCheetah they cost
    80,000 nats, and to refine them took two fifths of the time.
    """
    effects = [effect for group in groups for effect in group]
    first = tried(start, effects) if groups else None
    if first is None or first.held_out.sum() <= start.held_out.sum():
        return None
    refined = improved(start, first)
    found = iter(refined.effects)
    strong = tuple(tuple(next(found) for _ in group) for group in groups)
    return Block(strong, refined, refined.held_out - start.settled.held_out)


def name_effects(
    baseline: Fit,
    candidates: Sequence[Candidate],
    responses: Responses,
    block: Block | None,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[Alike], Fit, float]:
    """The effects with evidence, the fit with all of them, and the probability that the next one
    would be chance.

    `block`: effects to begin with, if they are far better together than any candidate alone.
    """
    named: list[Alike] = []
    current, chance = baseline, 1.0
    if block is not None and _is_far_better(block, baseline, candidates[:_REFINED]):
        named, current = _standing(block, baseline, rng)
        responses, chance = Responses(current), 0.0  # about the baseline all would be others
    together = len(named)  # these were weighed as a whole
    for count in range(together, _MOST_NAMED):
        doing = "refining the best effects" + (f" beside {count} named" if count else "")
        share = 0.1 + 0.7 * count / _MOST_NAMED
        alive = partial(progress, share, causes=count, doing=doing)
        alive()
        if count > 0:
            candidates = scan(current, responses)
        asked = [candidate.effects for candidate in _worth_refining(candidates)]
        alike, chance = weigh(current, asked, rng, alive)
        if not alike:
            break
        named.append(alike)
        current = smoothed(from_elsewhere(current, alike[0].fit))
        current = in_finer_steps(current, len(alike[0].effects))
        asked_again = range(together, count)
        named, current = reconsidered(named, current, asked_again, responses, rng, alive)
    alive = partial(progress, 0.8, causes=len(named), doing="weighing the causes together")
    named, current = _revised(named, current, responses, rng, alive)
    return named, current, chance


def _revised(
    named: list[Alike],
    current: Fit,
    responses: Responses,
    rng: np.random.Generator,
    alive: Callable[[], None],
) -> tuple[list[Alike], Fit]:
    """The named effects in the light of each other, until nothing changes."""
    for _ in range(_REVISIONS):
        alive()
        before = current
        named, current = narrowed(*pruned(named, current))
        alive()
        if len(named) > 1 or current is not before:
            everything = range(len(named))
            named, current = reconsidered(named, current, everything, responses, rng, alive)
        if current is before:
            break
    return named, current


def _is_far_better(block: Block, baseline: Fit, best: Sequence[Candidate]) -> bool:
    """True if a block leaves much less than the best candidate does alone, refined.

    What could be two causes or three is left to the search, which looks beyond forces.
    """
    most = THRESHOLD
    without = baseline.settled.held_out
    for candidate in best:
        refined = refine(baseline, candidate.effects)
        if refined is not None:
            most = max(most, float((refined.held_out - without).sum()))
            break
    readings = int(baseline.linear.chain.mask.sum()) * baseline.linear.residual.shape[2]
    return block.fair_gain - most > min(_FAR * most, _CLOSER * readings)


def _standing(block: Block, baseline: Fit, rng: np.random.Generator) -> tuple[list[Alike], Fit]:
    """The groups of a block that the others do not make superfluous, each with what these explain
    less alone, and the fit; none and the baseline, if there is evidence for no group."""
    whole: list[Alike] = [(Weighed(group, block.fit, block.gains, 0.0),) for group in block.groups]
    kept, current = pruned(whole, smoothed(block.fit))
    everything = held_out_without(current, ())
    named: list[Alike] = []
    for slot, (weighed,) in zip(slots(kept), kept, strict=True):
        alone = missed(weighed, range(slot.start, slot.stop), current, everything)
        confidence = float(decide(alone.gains[None], rng).confidence[0])
        named.append((replace(alone, confidence=confidence),))
    if not any(is_evidence(alone.gains) for (alone,) in named):
        return [], baseline
    return named, current


def _worth_refining(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates to refine: the best single ones, all that come close to the best up to
    `_MOST_REFINED`, and groups that beat it."""
    single = single_places(candidates)
    best = single[0].gain if single else 0.0
    chosen = max(single[:_REFINED], close_to_best(single), key=len)
    groups = [c for c in candidates if len(c.effects) > 1 and c.gain > best + THRESHOLD]
    return [*chosen, *groups[:_GROUPS_REFINED]]

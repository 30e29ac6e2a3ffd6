"""Every possible effect, linearised: how much evidence the data have for it, at which strength.

    candidates = scan(baseline, Responses(baseline))       # the best first
    candidates[0].effects, candidates[0].gain

An effect is tried beside the free parameters and the effects of a fit: what they can absorb is no
evidence. A group is one mechanism at all its places at once, each with a strength of its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector
from adr_service.criticism.decision import THRESHOLD, least_evident
from adr_service.criticism.fits import Fit
from adr_service.criticism.linear import Linear, Normal, inverse
from adr_service.criticism.noise import Whitener
from adr_service.criticism.periods import waves_in_turn
from adr_service.criticism.responses import Responses
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import LATE, Effect
from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.effects.models import element_of, prior_precision, shapes_of, typical_of

_ABSORBED = 1e2  # most that fitted parameters may divide the information on a strength by
_AT_ONCE = 2e7  # numbers of responses that are whitened at a time
_UNSEEN = 1e8  # variance of a strength, in the size that was tried, that no sensible robot has


@dataclass(frozen=True)
class Candidate:
    """One possible effect, or a group of one kind, at its estimated strengths."""

    tried: tuple[Effect, ...]  # at the sizes whose responses were simulated
    effects: tuple[Effect, ...]
    gains: Vector  # (E,) nats by episode, each left out of the fit
    # of each strength, the smallest that would be evidence, were all others that were tried known;
    # inf: no strength would be, or it is not identifiable
    limits: Vector

    @property
    def gain(self) -> float:
        return float(self.gains.sum())

    @property
    def kind(self) -> str:
        return self.effects[0].kind

    @property
    def location(self) -> str:
        return location_of(self.effects)


def scan(fit: Fit, responses: Responses) -> list[Candidate]:
    """A candidate for every kind at every location, and for every group; the best first."""
    known = {(effect.kind, effect.location) for effect in fit.effects}
    asked = [place for place in places(fit.simulator) if place not in known]
    waves: dict[str, dict[str, float]] = {}
    for kind in dict.fromkeys(k for k, _ in asked if get_mechanism(k).by_angle is not None):
        hinges = [location for each, location in asked if each == kind]
        to_unit = {hinge: responses.to_unit(kind, hinge) for hinge in hinges}
        waves[kind] = waves_in_turn(fit, to_unit)
    each = (_tried_at(fit.simulator, kind, location, waves) for kind, location in asked)
    tried = [sizes for sizes in each if sizes]
    look = Scan(fit, responses, [effect for sizes in tried for effect in sizes])
    candidates = [look.alone(sizes) for sizes in tried]
    groups: dict[str, list[Candidate]] = {}
    for candidate in candidates:
        if len(get_mechanism(candidate.kind).strengths) == 1:
            groups.setdefault(candidate.kind, []).append(candidate)
    candidates += [look.together(members) for members in groups.values() if len(members) > 1]
    return sorted(candidates, key=lambda candidate: -candidate.gain)


def _tried_at(
    simulator: Simulator, kind: str, location: str, waves: Mapping[str, Mapping[str, float]]
) -> list[Effect]:
    """An effect at a place, in all sizes where its response may differ.

    One that repeats with a joint's angle has so many `waves` in a turn, and is not tried at others.
    """
    typical, mechanism = typical_of(simulator.base, kind, location), get_mechanism(kind)
    if mechanism.by_angle is not None:
        if location not in waves[kind]:
            return []
        typical = np.where(shapes_of(kind), waves[kind][location], typical)
    sizes = [size * typical for size in mechanism.sizes]
    if mechanism.is_late:
        sizes += [np.array([steps * simulator.period]) for steps in LATE]
    return [Effect(kind, location, tuple(values.tolist())) for values in sizes]


def location_of(effects: Sequence[Effect]) -> str:
    """Location of one effect; `body:*` for a group of bodies."""
    first = effects[0].location
    return first if len(effects) == 1 else first.split(":")[0] + ":*"


def places(simulator: Simulator) -> list[tuple[str, str]]:
    """Every kind and location that may move predictions: no column that nobody measured, and
    nothing whose typical size is zero there."""
    base, is_measured = simulator.base, simulator.data.is_measured()
    return [
        (mechanism.kind, location)
        for mechanism in MECHANISMS.values()
        if not mechanism.only_spreads
        for location in mechanism.locations(base)
        if (sensing := mechanism.sensing) is None
        or is_measured[sensing.columns(base, element_of(base, location))].all()
        if typical_of(base, mechanism.kind, location).any()
    ]


class Scan:
    """Linearised fits of one candidate after the other.

    `normal` has a fit's `own` columns, and `columns` of each effect that can be simulated.
    """

    def __init__(self, fit: Fit, responses: Responses, tried: Sequence[Effect]):
        """`tried`: all effects, at all sizes where their responses may differ."""
        self._without = fit.held_out
        self.own = list(range(fit.linear.columns.shape[3]))
        mask, known = fit.linear.chain.mask, {effect: responses.of(effect) for effect in tried}
        finite = {effect: each for effect, each in known.items() if np.isfinite(each[mask]).all()}
        ends = len(self.own) + np.cumsum([len(effect.values) for effect in finite])
        self.columns = {
            effect: list(range(end - len(effect.values), end))
            for effect, end in zip(finite, ends.tolist(), strict=True)
        }
        precision = prior_precision(fit.simulator.base, list(finite))
        self.normal = _beside(fit, list(finite.values()), precision)

    def alone(self, sizes: Sequence[Effect]) -> Candidate:
        """The candidate at the best of the sizes where the response of its effect may differ."""
        best = self._nothing(sizes[:1])
        limits, nearest = best.limits, np.full(len(best.limits), np.inf)
        for effect in sizes:
            candidate = self._at([effect])
            if candidate is None:
                continue
            if candidate.gain > max(best.gain, 0.0):
                best = candidate
            # the limit by the size that is nearest to it: others' responses are not in proportion
            with np.errstate(divide="ignore", invalid="ignore"):
                apart = np.abs(np.log(candidate.limits / np.abs(effect.values)))
            limits = np.where(apart < nearest, candidate.limits, limits)
            nearest = np.fmin(apart, nearest)
        return replace(best, limits=limits)

    def together(self, members: Sequence[Candidate]) -> Candidate:
        """A group, without the places whose strength would make no sense."""
        left = everywhere = [tried for member in members for tried in member.tried]
        while len(left) > 1:
            group = self._at(left)
            if group is None:
                break
            sensible = [_makes_sense(*each) for each in zip(group.effects, left, strict=True)]
            if all(sensible):
                return group
            left = [effect for effect, is_so in zip(left, sensible, strict=True) if is_so]
        return self._nothing(everywhere)

    @cached_property
    def _limits(self) -> Vector:
        """(k,) the least of each tried column, in the size that was tried, that would be evidence
        beside the fit's own columns; inf if no sensible robot has so much."""
        own, tried = slice(len(self.own)), slice(len(self.own), None)
        absorbed = self.normal.absorbed(self.own, range(len(self.own), len(self.normal.mean)))
        information = self.normal.information
        each = np.diagonal(information[:, tried, tried], axis1=1, axis2=2)
        each = each - 2 * np.sum(absorbed * information[:, own, tried], axis=1)
        each = each + np.sum(absorbed * (information[:, own, own] @ absorbed), axis=1)  # (E, k)
        limits = np.array([least_evident(column) for column in each.T])
        return np.where(limits**2 < 2 * THRESHOLD * _UNSEEN, limits, np.inf)

    def _nothing(self, effects: Sequence[Effect]) -> Candidate:
        nothing = tuple(replace(e, values=(0.0,) * len(e.values)) for e in effects)
        unseen = np.array([np.inf for effect in effects for _ in effect.values])
        return Candidate(tuple(effects), nothing, np.zeros(len(self._without)), unseen)

    def _at(self, tried: Sequence[Effect]) -> Candidate | None:
        """The candidate in proportion to effects of one kind; None if it is not identifiable.

        A single effect whose estimated strength makes no sense has no strength and no gain.
        """
        if not all(effect in self.columns for effect in tried):
            return None
        new = [column for effect in tried for column in self.columns[effect]]
        sizes = np.concatenate([effect.values for effect in tried])
        normal = self.normal.only([*self.own, *new])
        change, covariance = normal.change()
        seen = _identifiable(normal, covariance, tried)
        if not seen.any():
            return None
        strengths = np.where(seen, change[-len(sizes) :] * sizes, 0.0)
        mechanism = get_mechanism(tried[0].kind)
        if mechanism.needs_first and not seen[0]:
            strengths[0] = sizes[0]  # any, for the others' sake
        strengths = np.where(shapes_of(mechanism.kind), sizes, strengths)
        gains = normal.left_out() - self._without
        split = np.split(strengths, len(tried))
        effects = tuple(
            replace(e, values=tuple(v.tolist())) for e, v in zip(tried, split, strict=True)
        )
        limits = np.where(seen, np.abs(sizes) * self._limits[np.array(new) - len(self.own)], np.inf)
        if len(tried) == 1 and not _makes_sense(effects[0], tried[0]):
            return replace(self._nothing(tried), limits=limits)
        return Candidate(tuple(tried), effects, gains, limits)


def _beside(fit: Fit, responses: Sequence[np.ndarray], precision: Vector) -> Normal:
    """Normal equations with responses (E, T, m, k) beside a fit's columns, whitened some episodes
    at a time, and the `precision` of their priors about zero."""
    linear, whitener = fit.linear, Whitener.of(fit.linear.chain, fit.noise)
    mean = np.concatenate([linear.mean, np.zeros(len(precision))])
    precision = np.concatenate([linear.precision, precision])
    episodes, *rest = linear.residual.shape
    step = max(1, int(_AT_ONCE / (np.prod(rest) * len(precision))))
    parts: list[Normal] = []
    for first in range(0, episodes, step):
        which = slice(first, first + step)
        columns = np.concatenate([linear.columns[which], *(r[which] for r in responses)], axis=3)
        part = whitener.of_episodes(which)
        columns[~part.chain.mask] = 0.0  # responses may be those of an earlier fit that has more
        some = Linear(part.chain, linear.residual[which], columns, mean, precision)
        parts.append(Normal.of(part, some))
    return Normal.joined(parts)


def _identifiable(normal: Normal, covariance: Matrix, tried: Sequence[Effect]) -> Mask:
    """(k,) of the last strengths: whether the data determine them without their priors.

    Strengths of one effect do not absorb each other: two that do much the same are one question.
    """
    sizes = np.concatenate([effect.values for effect in tried])
    new = slice(len(covariance) - len(sizes), None)
    which = np.repeat(np.arange(len(tried)), [len(effect.values) for effect in tried])
    is_own = which[:, None] == which
    alone = np.where(is_own, normal.information[:, new, new].sum(axis=0), 0.0)
    by_data = inverse(covariance[new, new]) - np.diag(normal.precision[new])
    least, variance = np.diagonal(inverse(alone)), np.diagonal(inverse(by_data))
    return (variance > 0) & (variance < _ABSORBED * least) & (variance < _UNSEEN)


def _makes_sense(estimated: Effect, tried: Effect) -> bool:
    """True if the strengths are possible, and on the side that was tried."""
    mechanism = get_mechanism(estimated.kind)
    values, low = np.array(estimated.values), [strength.low for strength in mechanism.strengths]
    is_other_side = mechanism.has_sides and np.any(values * tried.values < 0)
    return bool(np.all(values >= low) and not is_other_side)

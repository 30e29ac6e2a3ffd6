"""From a measurement to a verdict: what the simulator gets wrong, and what it costs.

    report = criticise(nominal, measurement, rng)
    report.verdict.finding              # "cause"
    report.extension.xml                # the simulator with the cause

Three quarters of the episodes tell causes apart, each judged by episodes that its fit has not
seen; the last quarter is opened once, for the gain. Causes are named one after the other, and
dropped again where the others make them superfluous.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import stats
from scipy.special import expit
from threadpoolctl import threadpool_limits

from adr_service.arrays import Vector
from adr_service.causes import Cause
from adr_service.criticism.advice import remarks, separating_experiment
from adr_service.criticism.decision import (
    ALIKE,
    THRESHOLD,
    TIE,
    Decision,
    beats,
    decide,
    is_evidence,
    is_unknown,
)
from adr_service.criticism.evidence import FINER, INTEGRATION, Fit, fit, refine, settled, smoothed
from adr_service.criticism.extension import Extension, extend
from adr_service.criticism.gain import measure_gain
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.readings import spread_causes
from adr_service.criticism.scan import Candidate, Effects, location_of, scan
from adr_service.criticism.simulator import Nominal, Simulator, check_measurement, is_first_order
from adr_service.criticism.verdict import Estimate, Finding, NamedCause, Residual, Verdict
from adr_service.criticism.yardstick import flexible_gains
from adr_service.progress import Progress, silent
from adr_service.simulation.mechanisms import get_mechanism, unit_of

_SEALED = 4  # every fourth episode
_REFINED, _CLOSE, _MOST_REFINED = 6, 0.9, 10  # the best, and all as good as that, but no more
_GROUPS_REFINED = 2
_OTHER_STARTS = (0.5, 2.0)  # times the strengths that were found
_PROMISING = THRESHOLD / 4  # [nats] by the scan; refining finds little more
_MOST_CAUSES = 5
_INTERVAL = 0.95


@dataclass(frozen=True)
class Criticism:
    """All that a report tells."""

    verdict: Verdict
    baseline: Fit
    final: Fit
    candidates: tuple[Candidate, ...]  # of the first scan, the best first
    extension: Extension | None  # None: nothing was named


@dataclass(frozen=True)
class _Weighed:
    """A candidate as the newest cause of a fit, and the evidence for it."""

    causes: tuple[Cause, ...]  # as they were tried: one, or a group
    fit: Fit
    gains: Vector  # (E,) nats
    confidence: float

    @property
    def gain(self) -> float:
        return float(self.gains.sum())

    @property
    def fair_gain(self) -> float:
        """A group must beat the best single place by what counts as evidence."""
        return self.gain - THRESHOLD * (len(self.causes) > 1)


_Named = tuple[_Weighed, ...]  # the best candidate, and all that explain as much


def criticise(
    nominal: Nominal,
    data: Measurement,
    rng: np.random.Generator,
    progress: Progress = silent,
    threads: int | None = None,
) -> Criticism:
    """What the data say of the simulator, on `threads` threads (None: all cores).

    The threads simulate; linear algebra has one, because its last digits depend on how many. Raises
    InvalidInput where the data do not fit the model, or are too few.
    """
    started = time.perf_counter()
    check_measurement(nominal, data)
    learned, sealed = split(data)
    sensor = data.sensor_variance()
    with ExitStack() as simulators:
        simulators.enter_context(threadpool_limits(1))
        progress(0.02)
        baseline = smoothed(_best_step(nominal, learned, sensor, threads, simulators), sensor)
        progress(0.1)
        effects = Effects(baseline)
        first = scan(baseline, effects)
        found, final, chance = _name(baseline, first, effects, sensor, rng, progress)
        progress(0.8, causes=len(found))
        found, final = _narrowed(*_pruned(found, final, sensor), sensor)
        progress(0.9, causes=len(found))
        gain = measure_gain(baseline, final, sealed, rng, threads) if found else None
        is_refuted = gain is not None and gain.high < 0  # by the sealed episodes
        notes = remarks(baseline.simulator.base, data)
        if is_refuted:
            notes = (*notes, _refuted(final.causes))
            found, final, gain, chance = [], baseline, None, 0.5 + _INTERVAL / 2
        whole = settled(final, sensor)
        flexible = flexible_gains(whole, sensor)
        confidence = _confidence(found, chance, flexible)
        finding: Finding = "none"
        if is_unknown(flexible, sum(named[0].gain for named in found)):
            finding, found, final, gain = "unknown", [], baseline, None
        found = _still_tied(found, final, sensor)
        spread = spread_causes(whole, sensor)
        experiments = [[separating_experiment(n[0].fit, o.fit) for o in n[1:]] for n in found]
    if finding == "none" and (found or spread):
        finding = "tie" if any(len(named) > 1 for named in found) else "cause"
        confidence = confidence if found else spread[0].confidence
    verdict = Verdict(
        finding,
        confidence=confidence,
        causes=(
            *(_named(final, at, named[0]) for at, named in zip(_slots(found), found, strict=True)),
            *spread,
        ),
        tied=(
            *(tuple(_alternative(other) for other in named[1:]) for named in found),
            *(() for _ in spread),
        ),
        experiments=(*map(tuple, experiments[: len(found)]), *(() for _ in spread)),
        residual=_residual(baseline, final, first, flexible),
        remarks=notes,
        gain=gain,
        seconds=time.perf_counter() - started,
    )
    extension = None
    if verdict.causes:
        beside = [Cause(c.kind, c.location, (c.strengths[0].value,)) for c in spread]
        extension = extend(nominal, final.parameters, [*final.causes, *beside])
    return Criticism(verdict, baseline, final, tuple(first), extension)


def split(data: Measurement) -> tuple[Measurement, Measurement]:
    """Episodes to learn from, and sealed ones."""
    numbers = np.arange(len(data.spans()))
    is_sealed = numbers % _SEALED == _SEALED - 1
    learned, sealed = (data.episodes(numbers[which].tolist()) for which in (~is_sealed, is_sealed))
    return learned, sealed


def _best_step(
    nominal: Nominal,
    data: Measurement,
    sensor: Vector,
    threads: int | None,
    simulators: ExitStack,
) -> Fit:
    """A first fit with the model's own step or a smaller one, whichever makes the data likelier
    (or simulates more of them at all).

    The step of an integrator of first order may be the largest error of all, and would look like
    inertia and friction; where the data were simulated with that very step, it is right.
    """
    steps = (1, FINER) if is_first_order(nominal.model(nominal.start)) else (1,)
    fits = [
        fit(simulators.enter_context(Simulator(nominal, data, threads, finer)), sensor)
        for finer in steps
    ]
    return max(fits, key=lambda each: (each.linear.chain.mask.sum(), each.held_out.sum()))


def _name(
    baseline: Fit,
    candidates: Sequence[Candidate],
    effects: Effects,
    sensor: Vector,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[list[_Named], Fit, float]:
    """Causes one after the other, each on its own evidence; the fit with all of them; and the
    probability that the next one would be chance."""
    found: list[_Named] = []
    current, chance = baseline, 1.0
    for count in range(_MOST_CAUSES):
        done = 0.1 + 0.7 * count / _MOST_CAUSES
        progress(done, causes=count)
        if count > 0:
            candidates = scan(current, effects)
        decision, weighed = _weigh(current, candidates, sensor, rng, partial(progress, done))
        chance = float(decision.confidence[-1])
        if not decision.alike:
            break
        found.append(_simplest_first([weighed[number] for number in decision.alike]))
        current = smoothed(_from_elsewhere(current, found[-1][0].fit, sensor), sensor)
    return found, current, chance


def _simplest_first(alike: Sequence[_Weighed]) -> _Named:
    """Of those that nothing tells apart, one with the fewest strengths, then the best; without
    those that are the same with a strength more."""
    best = max(each.fair_gain for each in alike)
    near = [each for each in alike if best - each.fair_gain < max(TIE, ALIKE * best)]
    first = min(near, key=lambda each: (sum(len(c.values) for c in each.causes), -each.fair_gain))
    named = {(cause.kind, cause.location) for cause in first.causes}
    others = [each for each in alike if each is first or not named <= _included(each.causes)]
    return (first, *(each for each in others if each is not first))


def _included(causes: Sequence[Cause]) -> set[tuple[str, str]]:
    return {(get_mechanism(cause.kind).includes, cause.location) for cause in causes}


def _from_elsewhere(current: Fit, found: Fit, sensor: Vector) -> Fit:
    """A fit with more causes than another, or a better one from other strengths of theirs."""
    known = len(current.causes)
    newest = found.causes[known:]
    starts = [
        [replace(c, values=tuple(factor * v for v in c.values)) for c in newest]
        for factor in _OTHER_STARTS
    ]
    others = (refine(current, [*current.causes, *start], sensor) for start in starts)
    fits = [found, *(other for other in others if other is not None)]
    return max(fits, key=lambda fit: fit.held_out.sum())


def _weigh(
    current: Fit,
    candidates: Sequence[Candidate],
    sensor: Vector,
    rng: np.random.Generator,
    alive: Callable[[], None],
) -> tuple[Decision, list[_Weighed]]:
    """The evidence for the best candidates, refined; `alive` is called before each."""
    single = [c for c in candidates if len(c.causes) == 1 and c.gain > _PROMISING]
    best = single[0].gain if single else 0.0
    close = [c for c in single if c.gain > _CLOSE * best]
    chosen = max(single[:_REFINED], close, key=len)[:_MOST_REFINED]
    groups = [c for c in candidates if len(c.causes) > 1 and c.gain > best + THRESHOLD]
    chosen += groups[:_GROUPS_REFINED]
    without = settled(current, sensor).held_out
    tried: list[tuple[tuple[Cause, ...], Fit | None]] = []
    for candidate in chosen:
        alive()
        causes = [*current.causes, *candidate.causes]
        tried.append((candidate.causes, refine(current, causes, sensor)))
    weighed = [_Weighed(c, f, f.held_out - without, 0.0) for c, f in tried if f is not None]
    fair = [each.gains + (each.fair_gain - each.gain) / len(without) for each in weighed]
    decision = decide(np.reshape(fair, (len(weighed), len(without))), rng)
    likely = decision.confidence[:-1].tolist()
    return decision, [replace(w, confidence=p) for w, p in zip(weighed, likely, strict=True)]


def _pruned(found: list[_Named], current: Fit, sensor: Vector) -> tuple[list[_Named], Fit]:
    """Without the causes that the others make superfluous."""
    while len(found) > 1:
        everything = settled(current, sensor).held_out
        shorter = [
            refine(current, [*current.causes[: slot.start], *current.causes[slot.stop :]], sensor)
            for slot in _slots(found)
        ]
        rests = {
            number: rest
            for number, rest in enumerate(shorter)
            if rest is not None and not is_evidence(everything - rest.held_out)
        }
        if not rests:
            break
        least, rest = max(rests.items(), key=lambda entry: entry[1].held_out.sum())
        found = [named for number, named in enumerate(found) if number != least]
        current = smoothed(rest, sensor)
    return found, current


def _narrowed(found: Sequence[_Named], current: Fit, sensor: Vector) -> tuple[list[_Named], Fit]:
    """With one place instead of a group that needs no other, now that all causes are known."""
    narrowed = list(found)
    for number, (group, *others) in enumerate(found):
        slot = _slots(narrowed)[number]
        if len(found) == 1 or len(group.causes) == 1:
            continue
        before, members, after = (
            current.causes[part] for part in (slice(slot.start), slot, slice(slot.stop, None))
        )
        alone = max(members, key=lambda cause: _significance(current, cause))
        rest = refine(current, [*before, alone, *after], sensor)
        if rest is None or is_evidence(settled(current, sensor).held_out - rest.held_out):
            continue
        single = [
            o for o in others if len(o.causes) == 1 and not _parts(o.causes) & _parts([alone])
        ]
        without = refine(current, [*before, *after], sensor)
        gains = group.gains if without is None else rest.held_out - without.held_out
        best = replace(group, causes=(alone,), fit=rest, gains=gains)
        narrowed[number] = (best, *single)
        current = smoothed(rest, sensor)
    return narrowed, current


def _significance(fit: Fit, cause: Cause) -> float:
    """Of the first strength of one of a fit's causes, in standard deviations."""
    before = fit.causes[: fit.causes.index(cause)]
    column = len(fit.parameters) + INTEGRATION + sum(len(c.values) for c in before)
    deviation = np.sqrt(fit.normal.change()[1][column, column])
    return abs(cause.values[0]) / deviation if deviation > 0 else 0.0


def _still_tied(found: list[_Named], final: Fit, sensor: Vector) -> list[_Named]:
    """Without alternatives that do worse than what was named, now that all causes are known."""
    if len(found) < 2:
        return found
    everything, left = settled(final, sensor).held_out, []
    for slot, (best, *others) in zip(_slots(found), found, strict=True):
        before, after = final.causes[: slot.start], final.causes[slot.stop :]
        kept: list[_Weighed] = []
        for other in others:
            newest = other.fit.causes[len(other.fit.causes) - len(other.causes) :]
            if _parts(newest) & _parts([*before, *after]):  # named elsewhere: no alternative here
                continue
            instead = refine(final, [*before, *newest, *after], sensor)
            if instead is not None and not beats(everything - instead.held_out, best.gain):
                kept.append(other)
        left.append((best, *kept))
    return left


def _parts(causes: Sequence[Cause]) -> set[tuple[str, str]]:
    return {(cause.kind, cause.location) for cause in causes}


def _confidence(found: Sequence[_Named], chance: float, flexible: Vector) -> float:
    """Of the whole verdict: that the first cause is among those named; of none; or of unknown.

    `chance` is the probability that no candidate is real.
    """
    if found:
        return min(1.0, sum(each.confidence for each in found[0]))
    unknown = float(expit(flexible.sum() - THRESHOLD))
    return unknown if is_unknown(flexible, 0.0) else chance * (1 - unknown)


def _refuted(causes: Sequence[Cause]) -> str:
    names = ", ".join(f"{cause.kind} {cause.location}" for cause in causes)
    return (
        f"In three quarters of the episodes the data ask for {names}, but in the others, which "
        "were opened last, predictions are worse with it; so it is not named. Do episodes differ "
        "in something that is not recorded?"
    )


def _slots(found: Sequence[_Named]) -> list[slice]:
    """Where the causes of a fit belong to each that was named."""
    ends = np.cumsum([len(named[0].causes) for named in found]).tolist()
    return [slice(e - len(n[0].causes), e) for e, n in zip(ends, found, strict=True)]


def _alternative(other: _Weighed) -> NamedCause:
    """A cause with the strengths that it has in the place of the named one."""
    count = len(other.fit.causes)
    return _named(other.fit, slice(count - len(other.causes), count), other)


def _named(fit: Fit, slot: slice, weighed: _Weighed) -> NamedCause:
    """Some of a fit's causes with intervals, as one cause or a group."""
    causes = fit.causes[slot]
    first = len(fit.parameters) + INTEGRATION + sum(len(c.values) for c in fit.causes[: slot.start])
    covariance = fit.normal.covariance()
    freedom = max(len(fit.held_out) - len(covariance), 1)
    reach = float(stats.t.ppf(0.5 + _INTERVAL / 2, freedom))
    estimates: list[Estimate] = []
    each = [
        (c, *one)
        for c in causes
        for one in zip(get_mechanism(c.kind).strengths, c.values, strict=True)
    ]
    for where, (cause, strength, value) in enumerate(each, first):
        unit = unit_of(fit.simulator.base, cause.location, strength.unit)
        name = strength.name if len(causes) == 1 else f"{cause.name} {strength.name}"
        if covariance[where, where] == 0:  # the data say nothing of it
            estimates.append(Estimate(name, value, -np.inf, np.inf, unit))
            continue
        error = reach * float(np.sqrt(max(covariance[where, where], 0.0)))
        low = max(value - error, strength.low)
        estimates.append(Estimate(name, value, low, value + error, unit))
    location, (gain, confidence) = location_of(causes), (weighed.gain, weighed.confidence)
    return NamedCause(causes[0].kind, location, tuple(estimates), confidence, gain)


def _residual(baseline: Fit, final: Fit, first: Sequence[Candidate], flexible: Vector) -> Residual:
    """`flexible` (E,) nats are those of a flexible force over the final simulator."""
    moved = {
        name: (before, after)
        for name, before, after in zip(
            baseline.simulator.nominal.space.names,
            baseline.parameters.tolist(),
            final.parameters.tolist(),
            strict=True,
        )
    }
    reach = np.sqrt(2 * THRESHOLD)  # standard deviations that gain as much
    base = final.simulator.base
    detectable = {
        f"{c.kind} {c.location}": (
            float(reach * c.deviations[0]),
            unit_of(base, c.location, get_mechanism(c.kind).strengths[0].unit),
        )
        for c in first
        if len(c.causes) == 1 and np.isfinite(c.deviations[0])
    }
    space, used = final.simulator.nominal.space, int(final.linear.chain.mask.sum())
    at_bound = (final.parameters <= space.feasible_low) | (final.parameters >= space.high)
    return Residual(
        noise=tuple(np.sqrt(final.noise.sensor).tolist()),
        step=base.opt.timestep / final.simulator.finer,
        own_step=base.opt.timestep,
        unexplained_nats=float(flexible.sum()),
        rest="unknown" if is_evidence(flexible) else "none",
        moved=moved,
        at_bound=tuple(n for n, is_at in zip(space.names, at_bound, strict=True) if is_at),
        used=used,
        diverged=int(final.layout.mask.sum()) - used,
        detectable=detectable,
    )

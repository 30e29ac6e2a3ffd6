"""From a measurement to a verdict: what the simulator gets wrong, and what it costs.

    criticism = criticise(nominal, measurement, rng)
    criticism.verdict.conclusion        # "cause"
    criticism.extension.xml             # the simulator with the cause

Three quarters of the episodes are for the search, where each effect is judged by episodes that its
fit has not seen. The last quarter is opened once, for the gain.
"""

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit
from threadpoolctl import threadpool_limits

from adr_service.arrays import Vector
from adr_service.criticism.compatibility import check_measurement
from adr_service.criticism.decision import THRESHOLD, is_unknown
from adr_service.criticism.evidence import gained
from adr_service.criticism.experiments import separating_experiment
from adr_service.criticism.extension import Extension, NotWritable, extend
from adr_service.criticism.fits import Fit, fit
from adr_service.criticism.flexible_force import Unexplained, unexplained
from adr_service.criticism.gain import measure_gain
from adr_service.criticism.identifiability import indistinguishable
from adr_service.criticism.intervals import INTERVAL
from adr_service.criticism.inverse import Group, needed_effects
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.naming import Block, block_of, name_effects
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.remarks import (
    on_commands,
    on_diverging,
    on_implausible,
    on_persistence,
    on_refuted,
    on_undetermined,
    on_unknown,
    on_untried,
    on_unwritable,
)
from adr_service.criticism.responses import Responses
from adr_service.criticism.revision import determined
from adr_service.criticism.scan import Candidate, scan
from adr_service.criticism.sensor_spread import spread_causes
from adr_service.criticism.simulator import FINER, Simulator, is_first_order
from adr_service.criticism.steps import in_steps_of
from adr_service.criticism.summary import alternative, named_cause, residual_of
from adr_service.criticism.verdict import Conclusion, Gain, NamedCause, Verdict
from adr_service.criticism.weighing import Alike, slots
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.progress import Progress, silent

_SEALED = 4  # every fourth episode
_Begun = tuple[Fit, Block | None]  # a first fit, and the effects that forces ask for
_ENOUGH, _FEWEST = 1000, 8  # transitions and episodes to choose the simulator's step by


@dataclass(frozen=True)
class Criticism:
    """Everything that a report shows."""

    verdict: Verdict
    baseline: Fit
    final: Fit
    candidates: tuple[Candidate, ...]  # of the first scan, the best first
    named: tuple[Alike, ...]  # each cause with what is tied with it
    extension: Extension | None  # None: nothing was named, or MuJoCo cannot write it


@dataclass(frozen=True)
class _Outcome:
    """The effects that the evidence names, so far."""

    named: list[Alike]
    final: Fit  # with all of them
    chance: float  # probability that the next one would be chance
    gain: Gain | None  # on the sealed episodes; None: nothing is named
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class _Judgement:
    """The named effects beside a flexible force, which may be the better explanation."""

    outcome: _Outcome
    spread: list[NamedCause]  # sensors that have steps, or noise that the measurement hides
    conclusion: Conclusion
    confidence: float
    flexible: Unexplained  # by a flexible force beside the named effects


def criticise(
    nominal: Nominal,
    data: Measurement,
    rng: np.random.Generator,
    progress: Progress = silent,
    threads: int | None = None,
) -> Criticism:
    """The effects that a simulator lacks by a measurement, on `threads` threads (None: all cores).

    The threads simulate; linear algebra has one, because its last digits depend on how many. Raises
    InvalidInput if the data do not fit the model, or are too few.
    """
    started = time.perf_counter()
    check_measurement(nominal, data)
    data = data.completed()
    learned, sealed = split(data)
    with ExitStack() as simulators:
        simulators.enter_context(threadpool_limits(1))
        progress(0.02, doing="fitting the simulator as it is")
        (start, block), own_diverges = _best_step(nominal, learned, rng, threads, simulators)
        baseline = smoothed(start)
        progress(0.1, doing="trying every effect at every place")
        responses = Responses(baseline)
        first = scan(baseline, responses)
        named, final, chance = name_effects(baseline, first, responses, block, rng, progress)
        if final.simulator is not baseline.simulator:
            baseline = in_steps_of(baseline, final.simulator)
        progress(0.9, causes=len(named), doing="judging what is left, and the sealed episodes")
        base = baseline.simulator.base
        found = named
        named, final, unsure = determined(found, final)
        if unsure and not named:
            chance = min(1 - _confidence_in([alike], []) for alike in found)
        remarks = (*on_commands(base, data), *on_untried(base), *on_undetermined(unsure))
        if own_diverges:
            remarks = (on_diverging(base.opt.timestep, FINER), *remarks)
        outcome = _Outcome(named, final, chance, None, remarks)
        outcome = _opened(outcome, baseline, sealed, threads)
        judgement = _judged(outcome, baseline)
        confused = indistinguishable(baseline, responses, first)
        verdict = _verdict(judgement, baseline, first, confused)
    verdict = replace(verdict, seconds=time.perf_counter() - started)
    final = judgement.outcome.final
    named_at_last = tuple(judgement.outcome.named)
    criticism = Criticism(verdict, baseline, final, tuple(first), named_at_last, None)
    return extended(criticism, nominal, judgement.spread) if verdict.causes else criticism


def extended(criticism: Criticism, nominal: Nominal, spread: Sequence[NamedCause]) -> Criticism:
    """The criticism with its extension, or with a remark if MuJoCo cannot write that."""
    final = criticism.final
    beside = [Effect(c.kind, c.location, (c.strengths[0].value,)) for c in spread]
    try:
        extension = extend(nominal, final.parameters, [*final.effects, *beside])
    except NotWritable as error:
        remarks = (*criticism.verdict.remarks, on_unwritable(str(error)))
        return replace(criticism, verdict=replace(criticism.verdict, remarks=remarks))
    return replace(criticism, extension=extension)


def split(data: Measurement) -> tuple[Measurement, Measurement]:
    """Episodes to learn from, and sealed ones."""
    numbers = np.arange(len(data.spans()))
    is_sealed = numbers % _SEALED == _SEALED - 1
    learned, sealed = (data.episodes(numbers[which].tolist()) for which in (~is_sealed, is_sealed))
    return learned, sealed


def _best_step(
    nominal: Nominal,
    data: Measurement,
    rng: np.random.Generator,
    threads: int | None,
    simulators: ExitStack,
) -> tuple[_Begun, bool]:
    """A first fit with the model's own step or a smaller one, whichever makes the data likelier
    (or simulates more of them at all), and the effects that forces ask for, if there are several;
    and true if the simulation diverges in the model's own step.

    The step of an integrator of first order may be the largest error of all, and would look like
    inertia and friction; if the data were simulated with that very step, it is right. Where many
    things are wrong at once, it is chosen with them. A part of many episodes tells it.
    """
    first = simulators.enter_context(Simulator(nominal, data, threads))
    groups = needed_effects(first)
    if not is_first_order(nominal.model(nominal.start)):
        return _begun(first, groups), False
    part = _part(data, rng)
    coarse = first if part is data else simulators.enter_context(Simulator(nominal, part, threads))
    begun = _begun_in_either(coarse, groups)
    own_diverges = begun[0][0].simulator is not coarse
    start, block = max(begun, key=_likelihood)
    if part is data:
        return (start, block), own_diverges
    whole = first if start.simulator is coarse else first.in_finer_steps
    return _begun(whole, groups if block is None else block.groups), own_diverges


def _part(data: Measurement, rng: np.random.Generator) -> Measurement:
    """All episodes, or some of them if half would be too many to choose a step by."""
    episodes = len(data.spans())
    transitions = len(data.time) - episodes
    count = max(episodes * _ENOUGH // transitions, _FEWEST)
    if 2 * count > episodes:
        return data
    return data.episodes(np.sort(rng.choice(episodes, count, replace=False)).tolist())


def _begun_in_either(coarse: Simulator, groups: Sequence[Group]) -> list[_Begun]:
    """First fits in a simulator's own steps and in finer ones, those that can be simulated.

    Raises InvalidInput if neither can.
    """
    begun: list[_Begun] = []
    refused: list[InvalidInput] = []
    for simulator in (coarse, coarse.in_finer_steps):
        try:
            begun.append(_begun(simulator, groups))
        except InvalidInput as error:
            refused.append(error)
    if not begun:
        raise refused[0]
    return begun


def _begun(simulator: Simulator, groups: Sequence[Group]) -> _Begun:
    start = fit(simulator, simulator.data.sensor_variance())
    return start, block_of(start, groups)


def _likelihood(begun: _Begun) -> tuple[int, float]:
    """Number of transitions that can be simulated, and how likely they are at best."""
    start, block = begun
    more = 0.0 if block is None else max(block.fair_gain, 0.0)
    return start.simulated, float(start.settled.held_out.sum()) + more


def _opened(outcome: _Outcome, baseline: Fit, sealed: Measurement, threads: int | None) -> _Outcome:
    """The outcome with its gain on the sealed episodes, which may refute the effects."""
    if not outcome.named:
        return outcome
    gain = measure_gain(baseline, outcome.final, sealed, threads)
    is_refuted = gain.high < 0
    if not is_refuted:
        return replace(outcome, gain=gain)
    remarks = (*outcome.remarks, on_refuted(outcome.final.effects))
    return _Outcome([], baseline, 0.5 + INTERVAL / 2, None, remarks)


def _judged(outcome: _Outcome, baseline: Fit) -> _Judgement:
    """The outcome beside a flexible force, which may explain more than all named effects."""
    whole = outcome.final.settled
    flexible = unexplained(whole)
    conclusion = Conclusion.NONE
    outcome = replace(outcome, remarks=(*outcome.remarks, *on_persistence(whole.persistence)))
    explained = float(gained(whole, baseline.settled).sum()) if outcome.named else 0.0
    if is_unknown(flexible.gains, explained):
        conclusion = Conclusion.UNKNOWN
        remarks = (*outcome.remarks, on_unknown())
        outcome = replace(outcome, named=[], final=baseline, gain=None, remarks=remarks)
    spread = spread_causes(whole)
    confidence = _confidence_without(outcome.chance, flexible.gains)
    if conclusion == Conclusion.NONE and (outcome.named or spread):
        is_tied = any(len(alike) > 1 for alike in outcome.named)
        conclusion = Conclusion.TIE if is_tied else Conclusion.CAUSE
        confidence = _confidence_in(outcome.named, spread)
    return _Judgement(outcome, spread, conclusion, confidence, flexible)


def _confidence_in(named: Sequence[Alike], spread: Sequence[NamedCause]) -> float:
    """Least probability that every cause is among what is named for it, however these depend on
    each other (Boole's inequality)."""
    right = [sum(each.confidence for each in alike) for alike in named]
    right += [cause.confidence for cause in spread]
    return max(0.0, 1 - sum(max(0.0, 1 - each) for each in right))


def _confidence_without(chance: float, flexible: Vector) -> float:
    """Probability that there is no cause or, where a flexible force is evidence, of that force.

    `chance` is the probability that no candidate is real.
    """
    unknown = float(expit(flexible.sum() - THRESHOLD))
    return unknown if is_unknown(flexible, 0.0) else chance * (1 - unknown)


def _verdict(
    judgement: _Judgement,
    baseline: Fit,
    first: Sequence[Candidate],
    confused: tuple[tuple[str, ...], ...],
) -> Verdict:
    """The verdict, but for the time that it took."""
    outcome, spread = judgement.outcome, judgement.spread
    named, final = outcome.named, outcome.final
    at = zip(slots(named), named, strict=True)
    return Verdict(
        judgement.conclusion,
        confidence=judgement.confidence,
        causes=(*(named_cause(final, slot, alike[0]) for slot, alike in at), *spread),
        tied=(
            *(tuple(alternative(other) for other in alike[1:]) for alike in named),
            *(() for _ in spread),
        ),
        experiments=(
            *(
                tuple(separating_experiment(alike[0].fit, other.fit) for other in alike[1:])
                for alike in named
            ),
            *(() for _ in spread),
        ),
        residual=residual_of(baseline, final, first, confused, judgement.flexible),
        remarks=(*outcome.remarks, *on_implausible(final.simulator.base, final.effects)),
        gain=outcome.gain,
        seconds=None,
    )

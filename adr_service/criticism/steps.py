"""The simulator's step, once causes are in.

    refined = refine(baseline, [effect])
    current = in_finer_steps(refined, 1, rng)       # one effect is new

A strong friction may need a smaller step than the model without it. What a coarse step gets wrong
of it would look like a second cause, and pull its own strength.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from adr_service.criticism.decision import THRESHOLD, is_evidence
from adr_service.criticism.evidence import Fit, fit, gained, smoothed
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.noise import Whitener
from adr_service.criticism.simulator import FINER, Simulator, is_first_order

_FINEST = FINER**2  # steps for one of the model's
_ENOUGH, _FEWEST = 1000, 8  # transitions and episodes to choose a step by


def in_finer_steps(current: Fit, newest: int, rng: np.random.Generator) -> Fit:
    """The fit in finer steps where these make the data likelier, and the fit itself elsewhere.

    It tries them only if its last effects, `newest` in number, do something else in these, and by
    so much that it would be evidence. A part of many episodes tells whether they do better.
    """
    while (
        is_first_order(current.simulator.base)
        and current.simulator.finer < _FINEST
        and _nats_of_finer_steps(current, newest) > THRESHOLD
    ):
        simulator = current.simulator
        part = part_of(simulator.data, rng)
        if part is not simulator.data and not _do_better_on(part, current):
            break
        finer = in_steps_of(current, simulator.in_finer_steps)
        if not is_evidence(gained(finer, current)):
            break
        current = finer
    return current


def in_steps_of(current: Fit, simulator: Simulator) -> Fit:
    """The fit anew by a simulator of the same model and data that takes other steps."""
    return smoothed(replace(current, simulator=simulator))


def part_of(data: Measurement, rng: np.random.Generator) -> Measurement:
    """All episodes, or some of them if half would be too many to choose a step by."""
    episodes = len(data.spans())
    transitions = len(data.time) - episodes
    count = max(episodes * _ENOUGH // transitions, _FEWEST)
    if 2 * count > episodes:
        return data
    return data.episodes(np.sort(rng.choice(episodes, count, replace=False)).tolist())


def _do_better_on(part: Measurement, current: Fit) -> bool:
    """True if finer steps make some episodes likelier, with the effects of a fit."""
    whole, effects = current.simulator, current.effects
    with Simulator(whole.nominal, part, whole.threads, whole.finer) as coarse:
        one, finer = (
            smoothed(fit(each, current.sensor, effects)) for each in (coarse, coarse.in_finer_steps)
        )
        return is_evidence(gained(finer, one))


def _nats_of_finer_steps(current: Fit, newest: int) -> float:
    """Evidence that would be in what finer steps change of the newest effects' doing."""
    simulator, states = current.simulator, current.states
    finely = partial(simulator.predict_finer, finer=FINER, integrator=simulator.base.opt.integrator)
    without = current.effects[: len(current.effects) - newest]
    finer, coarse = (
        predict(current.parameters, current.effects, states)
        - predict(current.parameters, without, states)
        for predict in (finely, simulator.predict)
    )
    chain = current.linear.chain
    change = current.layout.fold(np.nan_to_num(finer - coarse))
    change[~chain.mask] = 0.0
    white = Whitener.of(chain, current.noise).whiten(change[..., None])
    return float(0.5 * np.sum(white**2))

"""The simulator's step, once causes are in.

    refined = refine(baseline, [effect])
    current = in_finer_steps(refined, 1)            # one effect is new

A strong friction may need a smaller step than the model without it. What a coarse step gets wrong
of it would look like a second cause, and pull its own strength.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from adr_service.criticism.decision import THRESHOLD, beats
from adr_service.criticism.evidence import Fit, gained
from adr_service.criticism.noise import Whitener
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.simulator import FINER, Simulator, is_first_order

_FINEST = FINER**2  # steps for one of the model's


def in_finer_steps(current: Fit, newest: int) -> Fit:
    """The fit in finer steps where these make the data likelier, and the fit itself elsewhere.

    It tries them only if its last effects, `newest` in number, do something else in these, and by
    so much that it would be evidence.
    """
    while (
        is_first_order(current.simulator.base)
        and current.simulator.finer < _FINEST
        and _nats_of_finer_steps(current, newest) > THRESHOLD
    ):
        finer = in_steps_of(current, current.simulator.in_finer_steps)
        more = finer.simulated - current.simulated  # whose likelihoods count beside no others
        if more < 0 or (more == 0 and not beats(gained(finer, current), 0.0)):
            break
        current = finer
    return current


def in_steps_of(current: Fit, simulator: Simulator) -> Fit:
    """The fit anew by a simulator of the same model and data that takes other steps."""
    return smoothed(replace(current, simulator=simulator))


def _nats_of_finer_steps(current: Fit, newest: int) -> float:
    """Evidence that would be in what finer steps change of the newest effects' doing."""
    simulator, chain = current.simulator, current.linear.chain
    finely = partial(simulator.predict_finer, finer=FINER, integrator=simulator.base.opt.integrator)
    own = (current.parameters, current.effects, current.states)
    rest = (current.parameters, current.effects[: len(current.effects) - newest], current.states)
    beside = finely(*rest) - simulator.predict(*rest)
    change = current.layout.fold(np.nan_to_num(finely(*own) - current.predicted - beside))
    change[~chain.mask] = 0.0
    white = Whitener.of(chain, current.noise).whiten(change[..., None])
    return float(0.5 * np.sum(white**2))

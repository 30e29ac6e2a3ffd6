"""The simulator's step, once causes are in.

    refined = refine(baseline, [effect])
    current = in_finer_steps(refined, 1)            # one effect is new

A strong friction may need a smaller step than the model without it. What a coarse step gets wrong
of it would look like a second cause, and pull its own strength.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from adr_service.criticism.decision import beats
from adr_service.criticism.evidence import gained
from adr_service.criticism.fits import Fit
from adr_service.criticism.linear import Normal
from adr_service.criticism.noise import Whitener
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.simulator import FINER, Simulator, is_first_order
from adr_service.effects.catalogue import get_mechanism

_FINEST = FINER**2  # steps for one of the model's
_SURE, _FAR = 2.0, 0.02  # standard deviations, and of a strength: more is pulled


def in_finer_steps(current: Fit, newest: int) -> Fit:
    """The fit in finer steps where these make the data likelier, and the fit itself elsewhere.

    It tries them only if they would change a strength of its `newest` last effects.
    """
    while (
        is_first_order(current.simulator.base)
        and current.simulator.finer < _FINEST
        and _are_pulled(current, newest)
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


def _are_pulled(current: Fit, newest: int) -> bool:
    """True if finer steps would change a strength of the newest effects, by two standard deviations
    and more than 2 %, as far as all is linear.

    By what they change of these effects' own share of the predictions, beside parameters and other
    effects. The columns of what integration adds are left out: they have been fitted to that share.
    """
    simulator, linear = current.simulator, current.linear
    newest_effects = current.effects[len(current.effects) - newest :]
    if all(get_mechanism(effect.kind).sensing is not None for effect in newest_effects):
        return False  # which are not integrated
    finely = partial(simulator.predict_finer, finer=FINER, integrator=simulator.base.opt.integrator)
    own = (current.parameters, current.effects, current.states)
    rest = (current.parameters, current.effects[:-newest], current.states)
    beside = finely(*rest) - simulator.predict(*rest)
    change = current.layout.fold(np.nan_to_num(finely(*own) - current.predicted - beside))
    change[~linear.chain.mask] = 0.0
    moved = replace(linear, residual=linear.residual - change)
    finer = Normal.of(Whitener.of(linear.chain, current.noise), moved)
    kept = np.delete(np.arange(len(linear.mean)), current.integration).tolist()
    (before, covariance), (after, _) = (
        each.only(kept).change() for each in (current.normal, finer)
    )
    strengths = np.abs(np.concatenate([effect.values for effect in newest_effects]))
    pull = np.abs(after - before)[-len(strengths) :]
    deviation = np.sqrt(np.diagonal(covariance))[-len(strengths) :]
    return bool(np.any((pull > _SURE * deviation) & (pull > _FAR * strengths)))

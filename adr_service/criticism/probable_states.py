"""The most probable states of a recording under a fit, around which everything is linear anew.

    baseline = smoothed(fit(simulator, sensor))

Recordings that are smoothed for methods are in `smoothing`.
"""

from dataclasses import replace

import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.fits import (
    NEAR,
    Fit,
    are_near,
    likelier_of,
    most_probable,
    noise_anew,
    repeated_by_row,
    settled_there,
    with_effect_priors,
)
from adr_service.criticism.linearisation import linearise, root_of, tiny_root
from adr_service.criticism.variances import lifted

_SMOOTHINGS = 10  # at most, until parameters and strengths stay where they are
_PASSES = 5  # over the states alone, at most
_SMOOTH = 10.0  # [nats]; two passes that gain less were the last


def smoothed(fit: Fit) -> Fit:
    """A fit anew, around the states that are the most probable under it.

    And again where its parameters or strengths have come far, because its derivatives are those of
    before, and then while this makes the data likelier. Episodes that the new states make less
    likely keep theirs then, and go half the way next: near a contact the linear model does not
    hold.
    """
    share = np.ones(len(fit.linear.residual))
    for _ in range(_SMOOTHINGS):
        before, fit = fit, settled_there(linearised(fit, share))
        is_near = are_near(fit.simulator, before.effects, fit.effects)
        if is_near and _have_stayed(before.parameters, fit):
            break
    small = 0  # gains, one after the other
    for _ in range(_PASSES):
        other, is_likelier = likelier_of(fit, linearised(fit, share))
        gain = float(other.held_out.sum() - fit.held_out.sum())
        more = other.simulated - fit.simulated  # whose likelihoods count beside no others
        is_better = more > 0 or (more == 0 and gain > 0)
        fit = other if is_better else fit
        share = np.where(is_likelier & is_better, 1.0, share / 2)
        small = small + 1 if more == 0 and gain < _SMOOTH else 0
        if small == 2 or (small == 1 and is_likelier.all()):
            break
    return fit.settled


def _have_stayed(before: Vector, fit: Fit) -> bool:
    """True if all parameters are within a quarter, or a standard deviation, of what they were."""
    deviation = np.sqrt(np.diagonal(fit.normal.change()[1])[: len(before)])
    reach = np.maximum(NEAR * np.abs(before), deviation)
    return bool(np.all(np.abs(fit.parameters - before) <= reach))


def linearised(fit: Fit, share: Vector) -> Fit:
    """A fit's values, linear about states that are a share (E,) of the way from its own to those
    that are the most probable under it."""
    simulator, layout = fit.simulator, fit.layout
    probable, covariance = most_probable(fit)
    way = repeated_by_row(fit, share)[:, None]
    states = way * probable + (1 - way) * fit.states
    root = root_of(covariance, tiny_root(simulator))
    linear, predicted = linearise(simulator, layout, fit.parameters, fit.effects, states, root)
    linear = with_effect_priors(fit, linear, fit.effects)
    noise = lifted(fit.noise, linear.chain, linear.residual, fit.stated)
    return noise_anew(replace(fit, states=states, predicted=predicted, linear=linear, noise=noise))

"""The most probable states of a recording under a fit, around which everything is linear anew.

    baseline = smoothed(fit(simulator, sensor))

Recordings that are smoothed for methods are in `smoothing`.
"""

from dataclasses import replace

import numpy as np

from adr_service.arrays import Mask, Vector
from adr_service.criticism.evidence import (
    NEAR,
    Fit,
    are_near,
    with_effect_priors,
)
from adr_service.criticism.linearisation import linearise, root_of, tiny_root
from adr_service.criticism.noise import Whitener, lifted
from adr_service.criticism.within_bounds import estimate_within_bounds

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
        before, fit = fit, linearised(fit, share).settled
        is_near = are_near(fit.simulator, before.effects, fit.effects)
        if is_near and _have_stayed(before.parameters, fit):
            break
    small = 0  # gains, one after the other
    for _ in range(_PASSES):
        other, is_likelier = _likelier_of(fit, linearised(fit, share))
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
    whitener = Whitener.of(fit.linear.chain, fit.noise)
    errors, covariance = whitener.sensor_errors(fit.left)
    probable = simulator.measured - layout.by_row(simulator, errors)
    way = _by_row(fit, share)[:, None]
    states = way * probable + (1 - way) * fit.states
    root = root_of(layout.by_row(simulator, covariance), tiny_root(simulator))
    linear, predicted = linearise(simulator, layout, fit.parameters, fit.effects, states, root)
    linear = with_effect_priors(fit, linear, fit.effects)
    noise = lifted(fit.noise, linear.chain, linear.residual, fit.stated)
    return _within(replace(fit, states=states, predicted=predicted, linear=linear, noise=noise))


def _likelier_of(fit: Fit, other: Fit) -> tuple[Fit, Mask]:
    """Each episode as one of two fits has it that differ in their states alone, whichever simulates
    more of it or makes it likelier, and (E,) true where that is the other."""
    counts, more = (each.linear.chain.mask.sum(axis=1) for each in (fit, other))
    is_likelier = (more > counts) | ((more == counts) & (other.held_out > fit.held_out))
    if is_likelier.all():
        return other, is_likelier

    def chosen(new: np.ndarray, old: np.ndarray, which: Mask = is_likelier) -> np.ndarray:
        return np.where(which.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    new, old, by_row = other.linear, fit.linear, _by_row(fit, is_likelier)
    chain = replace(
        new.chain,
        mask=chosen(new.chain.mask, old.chain.mask),
        transition=chosen(new.chain.transition, old.chain.transition),
        stiff=chosen(new.chain.stiff, old.chain.stiff),
    )
    linear = replace(
        new,
        chain=chain,
        residual=chosen(new.residual, old.residual),
        columns=chosen(new.columns, old.columns),
    )
    noise = replace(other.noise, weights=chosen(other.noise.weights, fit.noise.weights))
    mixed = replace(
        fit,
        states=chosen(other.states, fit.states, by_row),
        predicted=chosen(other.predicted, fit.predicted, by_row[fit.simulator.starts]),
        linear=linear,
        noise=lifted(noise, chain, linear.residual, fit.stated),
    )
    return _within(mixed), is_likelier


def _within(fit: Fit) -> Fit:
    """A fit with its noise estimated anew, where no parameter leaves its bounds."""
    known = (fit.parameters, fit.effects, fit.linear, fit.noise, fit.stated)
    linear, noise, normal = estimate_within_bounds(fit.simulator, *known)
    return replace(fit, linear=linear, noise=noise, normal=normal)


def _by_row(fit: Fit, values: np.ndarray) -> np.ndarray:
    """Values (E,) of episodes for each row (rows,)."""
    return np.concatenate(
        [np.repeat(v, b - a) for v, (a, b) in zip(values, fit.simulator.data.spans(), strict=True)]
    )

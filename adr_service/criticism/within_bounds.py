"""Fits whose parameters and strengths stay within their bounds.

Columns are the parameters, integration, and the effects' strengths.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adr_service.arrays import Mask, Vector
from adr_service.criticism.bounded_steps import Bounds
from adr_service.criticism.linear import Linear, Normal, estimate
from adr_service.criticism.linearisation import INTEGRATION
from adr_service.criticism.noise import Noise
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import plausible_of

# of its range, or of a plausible strength, the deviation of what goes no further than its bound
_HELD = 1e-6
_AT_BOUND = 1e-3  # of a plausible strength: what is nearer to its bound is at it
_NEARLY = 0.9  # of the way to nothing, which a strength beside others could never leave again


def estimate_within_bounds(
    simulator: Simulator,
    parameters: Vector,
    effects: Sequence[Effect],
    linear: Linear,
    start: Noise,
    stated: Mask,
) -> tuple[Linear, Noise, Normal]:
    """`estimate`, with the parameters and strengths held that would leave their bounds.

    So misfit that only a parameter beyond its bounds would explain stays, as evidence, and a
    strength gains nothing by what only a negative one would explain.
    """
    bounds = _bounds_of(simulator, parameters, [_lowest(effect) for effect in effects])
    values, scales = values_of(parameters, effects), _scales_of(simulator, effects)
    is_near = np.zeros(len(values), dtype=np.bool_)
    is_near[len(parameters) + INTEGRATION :] = nearly_at_bounds(simulator, effects)
    above = np.where(is_near, values - bounds.low, 0.0)
    held = np.zeros(len(values), dtype=np.bool_)
    while True:
        start, normal = estimate(linear, start, stated)
        leaving = ~held & bounds.leaving(values, normal.change()[0], is_near)
        if not leaving.any():
            return linear, start, normal
        held |= leaving
        mean, precision = linear.mean.copy(), linear.precision.copy()
        mean[held], precision[held] = 0.0, 1 / np.maximum(_HELD * scales, above)[held] ** 2
        linear = replace(linear, mean=mean, precision=precision)


def nearly_at_bounds(simulator: Simulator, effects: Sequence[Effect]) -> Mask:
    """(k,) true for strengths that are so near to their least that they may be that, which one
    beside others never reaches."""
    found = [np.empty(0, dtype=np.bool_)]
    for effect in effects:
        above = np.array(effect.values) - _lowest(effect)
        reach = _AT_BOUND * plausible_of(simulator.base, effect)
        found.append((len(above) > 1) & (above <= reach))
    return np.concatenate(found)


def values_of(parameters: Vector, effects: Sequence[Effect]) -> Vector:
    """(p,) values of all columns, those of integration as 0."""
    strengths = [effect.values for effect in effects]
    return np.concatenate([parameters, np.zeros(INTEGRATION), *strengths])


def bounds_of_steps(simulator: Simulator, parameters: Vector, effects: Sequence[Effect]) -> Bounds:
    """Bounds (p,) of all columns that a step leads to."""
    return _bounds_of(simulator, parameters, [_least_of(effect) for effect in effects])


def _bounds_of(simulator: Simulator, parameters: Vector, least: Sequence[Vector]) -> Bounds:
    """Bounds (p,) of all columns, with the least strengths of each effect; of parameters, at most
    what they are or their space has."""
    space = simulator.nominal.space
    free = np.full(INTEGRATION, np.inf)
    low = np.concatenate([space.feasible_low, -free, *least])
    high = np.full(len(low), np.inf)
    high[: len(parameters)] = np.maximum(space.high, parameters)
    return Bounds(low, high, (np.arange(len(low)) < len(parameters)) & (low > 0))


def _least_of(effect: Effect) -> Vector:
    """(k,) the least strengths that a step leads to.

    One of several that was nothing would stay so, because nothing can be said of it then.
    """
    low = _lowest(effect)
    nearly = (1 - _NEARLY) * np.array(effect.values)
    return np.where((len(low) > 1) & (low == 0), np.maximum(nearly, 0.0), low)


def _lowest(effect: Effect) -> Vector:
    """(k,) the least strengths that make sense."""
    return np.array([strength.low for strength in get_mechanism(effect.kind).strengths])


def _scales_of(simulator: Simulator, effects: Sequence[Effect]) -> Vector:
    """(p,) ranges of parameters, and plausible strengths."""
    space, base = simulator.nominal.space, simulator.base
    likely = [plausible_of(base, effect) for effect in effects]
    return np.concatenate([space.high - space.low, np.ones(INTEGRATION), *likely])

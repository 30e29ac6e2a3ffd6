"""Intervals of the strengths of a fit's effects.

for strength in intervals(fit, slice(0, 1)): ...
may_be_nothing(fit, slice(0, 1))        # True if all of them hold zero
"""

import numpy as np
from scipy import stats

from adr_service.criticism.evidence import Fit
from adr_service.criticism.verdict import StrengthInterval
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import shapes_of, unit_of

INTERVAL = 0.95


def intervals(fit: Fit, slot: slice) -> tuple[StrengthInterval, ...]:
    """Intervals of all strengths of some effects, by the sandwich estimate of their variance."""
    effects = fit.effects[slot]
    covariance = fit.normal.covariance()
    freedom = max(len(fit.held_out) - len(covariance), 1)
    reach = float(stats.t.ppf(0.5 + INTERVAL / 2, freedom))
    variances = np.diagonal(covariance)[fit.columns_of(slot)].tolist()
    found: list[StrengthInterval] = []
    for effect in effects:
        for strength, value in zip(
            get_mechanism(effect.kind).strengths, effect.values, strict=True
        ):
            variance = variances[len(found)]
            error = reach * float(np.sqrt(max(variance, 0.0)))
            bounds = (max(value - error, strength.low), value + error)
            unit = unit_of(fit.simulator.base, effect.location, strength.unit)
            name = strength.name if len(effects) == 1 else f"{effect.name} {strength.name}"
            low, high = bounds if variance != 0 else (-np.inf, np.inf)  # zero: not identifiable
            found.append(StrengthInterval(name, value, low, high, unit))
    return tuple(found)


def may_be_nothing(fit: Fit, slot: slice) -> bool:
    """True if the intervals of all strengths of some effects hold zero; a shape is none."""
    is_shape = np.concatenate([shapes_of(effect.kind) for effect in fit.effects[slot]])
    each = zip(is_shape, intervals(fit, slot), strict=True)
    return all(shape or strength.low <= 0 <= strength.high for shape, strength in each)

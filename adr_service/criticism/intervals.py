"""Intervals of the strengths of a fit's effects, by the sandwich estimate of their covariance.

for strength in intervals(fit, slice(0, 1)): ...
may_be_nothing(fit, slice(0, 1))        # True if all of them may be zero at once
"""

import numpy as np
from scipy import stats

from adr_service.criticism.fits import Fit
from adr_service.criticism.verdict import StrengthInterval
from adr_service.criticism.within_bounds import nearly_at_bounds
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import shapes_of, unit_of

INTERVAL = 0.95


def intervals(fit: Fit, slot: slice) -> tuple[StrengthInterval, ...]:
    """Intervals of all strengths of some effects."""
    effects = fit.effects[slot]
    covariance = fit.normal.covariance()
    reach = float(stats.t.ppf(0.5 + INTERVAL / 2, fit.normal.freedom))
    variances = np.diagonal(covariance)[fit.columns_of(slot)].tolist()
    found: list[StrengthInterval] = []
    is_near = nearly_at_bounds(fit.simulator, effects).tolist()
    for effect in effects:
        for strength, value in zip(
            get_mechanism(effect.kind).strengths, effect.values, strict=True
        ):
            variance = variances[len(found)]
            error = reach * float(np.sqrt(max(variance, 0.0)))
            low = strength.low if is_near[len(found)] else max(value - error, strength.low)
            bounds = (low, value + error)
            unit = unit_of(fit.simulator.base, effect.location, strength.unit)
            name = strength.name if len(effects) == 1 else f"{effect.name} {strength.name}"
            low, high = bounds if variance != 0 else (-np.inf, np.inf)  # zero: not identifiable
            found.append(StrengthInterval(name, value, low, high, unit))
    return tuple(found)


def may_be_nothing(fit: Fit, slot: slice) -> bool:
    """True if the 95 % region of the strengths of some effects holds zero; shapes are no part of
    it, nor are strengths nearly at their bounds, nor is what the data do not identify. Of one
    strength that is its interval.

    Strengths of a group may be unsure one by one, and sure together (Wald's test, with Fisher's F
    for few episodes).
    """
    effects = fit.effects[slot]
    covariance = fit.normal.covariance()
    values = np.concatenate([effect.values for effect in effects])
    columns = np.arange(len(covariance))[fit.columns_of(slot)]
    is_shape = np.concatenate([shapes_of(effect.kind) for effect in effects])
    known = (
        ~is_shape
        & ~nearly_at_bounds(fit.simulator, effects)
        & (np.diagonal(covariance)[columns] > 0)
    )
    count = int(known.sum())
    if count == 0:
        return True
    own = covariance[np.ix_(columns[known], columns[known])]
    deviation = np.sqrt(np.diagonal(own))
    away = values[known] / deviation
    distance = away @ np.linalg.pinv(own / np.outer(deviation, deviation), hermitian=True) @ away
    return bool(distance <= count * stats.f.ppf(INTERVAL, count, fit.normal.freedom))

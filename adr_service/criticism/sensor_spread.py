"""Spread that sensors add to readings: steps, and more noise than the measurement states.

Neither moves a reading on average, so predictions cannot reveal them. Steps show in the readings
themselves, which then lie on a lattice. They count if they are a good part of the sensor's noise,
and coarser than the last digits that every number in a file has. Excess noise is seen only if the
measurement states how much there should be.
"""

from dataclasses import replace

import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.decision import is_evidence
from adr_service.criticism.fits import Fit, settled_there
from adr_service.criticism.verdict import NamedCause, StrengthInterval
from adr_service.effects.base import sensors
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import unit_of

_NEAR = 1e-3  # of a step: how near to the lattice all readings are
_LEAST_LEVELS, _FINEST = 3, 1e4  # steps over the whole range
_PARTS, _SAME = (1, 2, 3, 4), 1e-9  # of the range: what rounding makes of one level
_NOTICED = 0.5  # of a sensor's variance, that steps or excess noise must be
_REACH = 1.96  # standard errors


def spread_causes(fit: Fit) -> list[NamedCause]:
    """Sensors with steps, or with more noise than is stated."""
    causes: list[NamedCause] = []
    measured = fit.simulator.data.is_measured()
    for number, readings in enumerate(fit.simulator.measured.T):
        if not measured[number]:
            continue
        stepped = _stepped(fit, number, readings)
        noisy = None if stepped else _noisier(fit, number)
        causes += [cause for cause in (stepped, noisy) if cause is not None]
    return causes


def lattice(readings: Vector) -> float | None:
    """Largest step that divides the distances of all readings (n,); None if there is none."""
    levels = np.unique(readings)
    if len(levels) < _LEAST_LEVELS:
        return None
    gaps = np.diff(levels)
    smallest = float(gaps[gaps > _SAME * np.ptp(levels)].min())
    for part in _PARTS:  # of the smallest gap, which may be of several steps
        count = np.round(np.ptp(levels) / smallest * part)
        if count > _FINEST:  # the last digits of a file
            return None
        step = float(np.ptp(levels) / count)
        off = (levels - levels[0]) / step
        if np.all(np.abs(off - np.round(off)) < _NEAR):
            return step
    return None


def _stepped(fit: Fit, number: int, readings: Vector) -> NamedCause | None:
    step = lattice(readings)
    if step is None or step**2 / 12 < _NOTICED * fit.noise.sensor[number]:
        return None
    # that readings without steps were all so near to a lattice
    gain = -len(readings) * float(np.log(2 * _NEAR))
    return _cause(fit, "sensor_quantisation", number, step, 0.0, gain)


def _noisier(fit: Fit, number: int) -> NamedCause | None:
    stated = fit.sensor[number]
    if np.isnan(stated):
        return None
    sensor = np.where(np.arange(len(fit.sensor)) == number, np.nan, fit.sensor)
    free = settled_there(replace(fit, sensor=sensor))
    more = free.noise.sensor[number] - stated
    gains = free.held_out - fit.held_out
    if more < _NOTICED * stated or not is_evidence(gains):
        return None
    deviation = float(np.sqrt(more))
    # of a variance, from as many readings
    error = float(free.noise.sensor[number] / np.sqrt(2 * len(fit.simulator.measured)) / deviation)
    return _cause(fit, "sensor_noise", number, deviation, _REACH * error, float(gains.sum()))


def _cause(fit: Fit, kind: str, number: int, value: float, reach: float, gain: float) -> NamedCause:
    model = fit.simulator.base
    location = f"sensor:{sensors(model)[number]}"
    (strength,) = get_mechanism(kind).strengths
    unit = unit_of(model, location, strength.unit)
    interval = StrengthInterval(strength.name, value, max(value - reach, 0.0), value + reach, unit)
    return NamedCause(kind, location, (interval,), 1.0 - float(np.exp(-gain)), gain)

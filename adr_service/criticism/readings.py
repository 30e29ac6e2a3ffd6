"""What sensors do to readings beside moving them: steps, and more noise than was said.

Neither changes what is predicted on average, so neither is found by predictions. Steps are seen in
the readings themselves, which then lie on a lattice; they count where they are a good part of the
sensor's noise, and not as fine as the last digits that every number in a file has. More noise can
only be told where the measurement says how much there should be.
"""

import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.decision import is_evidence
from adr_service.criticism.evidence import Fit, settled
from adr_service.criticism.verdict import Estimate, NamedCause
from adr_service.simulation.mechanism import sensors
from adr_service.simulation.mechanisms import get_mechanism, unit_of

_NEAR = 1e-3  # of a step: how near to the lattice all readings are
_LEAST_LEVELS, _FINEST = 3, 1e4  # steps over the whole range
_PARTS, _SAME = (1, 2, 3, 4), 1e-9  # of the range: what rounding makes of one level
_NOTICED = 0.5  # of a sensor's variance: what steps or unsaid noise must be of it
_REACH = 1.96  # standard errors


def spread_causes(fit: Fit, sensor: Vector) -> list[NamedCause]:
    """Sensors that have steps, or more noise than `sensor` (m,) says (NaN: nothing is said)."""
    found: list[NamedCause] = []
    measured = fit.simulator.data.is_measured()
    for number, readings in enumerate(fit.simulator.measured.T):
        if not measured[number]:
            continue
        stepped = _stepped(fit, number, readings)
        noisy = None if stepped else _noisier(fit, number, sensor)
        found += [cause for cause in (stepped, noisy) if cause is not None]
    return found


def lattice(readings: Vector) -> float | None:
    """The step of which all readings (n,) are whole multiples apart; None where there is none."""
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


def _noisier(fit: Fit, number: int, sensor: Vector) -> NamedCause | None:
    said = sensor[number]
    if np.isnan(said):
        return None
    free = settled(fit, np.where(np.arange(len(sensor)) == number, np.nan, sensor))
    more = free.noise.sensor[number] - said
    gains = free.held_out - fit.held_out
    if more < _NOTICED * said or not is_evidence(gains):
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
    estimate = Estimate(strength.name, value, max(value - reach, 0.0), value + reach, unit)
    return NamedCause(kind, location, (estimate,), 1.0 - float(np.exp(-gain)), gain)

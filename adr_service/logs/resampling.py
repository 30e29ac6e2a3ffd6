"""One column of a recording at other times.

States: a cubic spline through all readings or, where a velocity is to be derived, a parabola
through those about each time. Commands: their mean between two times.
"""

from itertools import pairwise

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from adr_service.arrays import Indices, Vector
from adr_service.logs.base import Signal
from adr_service.logs.tracks import GAP, LEAST_READINGS, Track

_TO_STD = 1.4826  # from the median of absolute deviations to a standard deviation


def sampled(track: Track, centres: Vector, period: float) -> tuple[Vector, Vector]:
    """Values and slopes at the centres (n,), by the readings of their stretch alone."""
    time, value = track.signal.time, track.signal.value
    edges = [edge for gap in track.gaps() for edge in gap]
    begin = max([edge for edge in edges if edge <= centres[0]], default=-np.inf)
    end = min([edge for edge in edges if edge >= centres[-1]], default=np.inf)
    own = (time >= begin) & (time <= end)
    if track.is_fitted:
        return _parabolas(Signal(time[own], value[own]), centres, period)
    spline = CubicSpline(time[own], value[own])
    return spline(centres), spline(centres, 1)


def _parabolas(signal: Signal, centres: Vector, period: float) -> tuple[Vector, Vector]:
    values, slopes = np.empty(len(centres)), np.empty(len(centres))
    for row, (first, last) in enumerate(_windows(signal, centres, period)):
        # in units of half a period, for the numbers' sake
        near = (signal.time[first:last] - centres[row]) / (period / 2)
        shape = np.vander(near, 3, increasing=True)
        fitted = np.linalg.lstsq(shape, signal.value[first:last], rcond=None)[0]
        values[row], slopes[row] = fitted[0], fitted[1] / (period / 2)
    return values, slopes


def _windows(signal: Signal, centres: Vector, period: float) -> list[tuple[int, int]]:
    """Half-open ranges of the readings in each window; one that has too few gets the nearest."""
    edges = np.append(centres - period / 2, centres[-1] + period / 2)
    numbers = np.searchsorted(signal.time, edges).tolist()
    return [_widened(first, last, len(signal.time)) for first, last in pairwise(numbers)]


def _widened(first: int, last: int, count: int) -> tuple[int, int]:
    while last - first < min(LEAST_READINGS, count):
        first, last = max(first - 1, 0), min(last + 1, count)
    return first, last


def edges(time: Vector, period: float, steps: int) -> Vector:
    """(n steps + 1,) where each of so many steps of each row begins, and where the last ends."""
    parts = period / steps * np.arange(steps)
    return np.append((time[:, None] + parts).ravel(), time[-1] + period)


def held(signal: Signal, edges: Vector) -> Vector:
    """Mean between neighbouring edges of a command that holds until the next one comes."""
    lasting = np.diff(signal.time, append=max(edges[-1], signal.time[-1]))
    area = np.concatenate([[0.0], np.cumsum(signal.value * lasting)])
    number = _number_at(signal.time, edges)
    until = area[number] + signal.value[number] * (edges - signal.time[number])
    return np.diff(until) / np.diff(edges)


def interpolated(signal: Signal, edges: Vector) -> Vector:
    """Mean between neighbouring edges of a command that moves in straight lines."""
    area = cumulative_trapezoid(signal.value, signal.time, initial=0.0)
    number = _number_at(signal.time, edges)
    value = np.interp(edges, signal.time, signal.value)
    until = area[number] + (signal.value[number] + value) / 2 * (edges - signal.time[number])
    return np.diff(until) / np.diff(edges)


def _number_at(times: Vector, moments: Vector) -> Indices:
    """The number of the last of some times (n,) before each moment, or of the first."""
    return np.maximum(np.searchsorted(times, moments, side="right") - 1, 0)


def scatter(track: Track) -> float:
    """`Column.scatter`."""
    time, value = track.signal.time, track.signal.value
    own = np.arange(2, len(time) - 2)
    own = own[time[own + 2] - time[own - 2] <= GAP * 4 * track.spacing]
    if not len(own):
        return np.nan
    near = own[:, None] + np.array([-2, -1, 1, 2])
    away = (time[near] - time[own][:, None]) / track.spacing  # (k, 4)
    # Lagrange's weights of the neighbours at the reading: prod_j t_j / (t_j - t_i), j other than i
    apart = away[:, None, :] - away[:, :, None]
    factors = np.divide(away[:, None, :], apart, out=np.ones_like(apart), where=apart != 0)
    weights = factors.prod(axis=2)
    misses = value[own] - np.sum(weights * value[near], axis=1)
    single = misses / np.sqrt(1 + np.sum(weights**2, axis=1))
    levels = np.diff(np.unique(value))
    step = float(levels.min()) / np.sqrt(12) if len(levels) else 0.0
    return max(float(_TO_STD * np.median(np.abs(single))), step)

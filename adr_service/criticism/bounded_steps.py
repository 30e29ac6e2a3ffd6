"""Steps of a fit's free parameters within their bounds; what is positive moves in proportion.

within = limited(space, parameters, step)       # of all columns, the parameters' first
parameters = moved(space, parameters, within)
step = shorter(step, within)                    # if that was refused
"""

import numpy as np

from adr_service.arrays import Mask, Vector
from adr_service.parameters import ParameterSpace

_FACTOR = 2.0  # logarithm of the factor by which a positive parameter changes at most in a step
_WHOLE = 1 - 1e-9  # of a step, or of a way to a bound, but for rounding


def limited(space: ParameterSpace, parameters: Vector, step: Vector) -> Vector:
    """A step of all columns, that of parameters to their bounds and by a factor of e² at most."""
    low, high, positive = _bounds(space, parameters)
    safe = np.where(positive, parameters, 1.0)
    ends = [
        np.where(positive, safe * np.log(np.where(positive, end, 1.0) / safe), end - parameters)
        for end in (low, high)
    ]
    least = np.where(positive, np.maximum(ends[0], -_FACTOR * safe), ends[0])
    most = np.where(positive, np.minimum(ends[1], _FACTOR * safe), ends[1])
    return np.concatenate([np.clip(step[: len(low)], least, most), step[len(low) :]])


def moved(space: ParameterSpace, parameters: Vector, step: Vector) -> Vector:
    """Parameters (d,) after a step, at a bound to the last bit if it leads there."""
    low, high, positive = _bounds(space, parameters)
    own = step[: len(low)]
    factor = np.exp(own / np.where(positive, parameters, np.inf))
    after = np.where(positive, parameters * factor, parameters + own)
    rounding = (1 - _WHOLE) * (high - low)
    return np.where(after < low + rounding, low, np.where(after > high - rounding, high, after))


def shorter(step: Vector, within: Vector) -> Vector:
    """A step of all columns in its direction, as far as the one `within` bounds goes in each; half
    of it, if it is within them itself."""
    cut = (np.abs(within) < _WHOLE * np.abs(step)) & (within != 0)
    return step * np.min(within[cut] / step[cut]) if cut.any() else step / 2


def _bounds(space: ParameterSpace, parameters: Vector) -> tuple[Vector, Vector, Mask]:
    """Bounds of parameters, and which of them are positive."""
    return space.feasible_low, np.maximum(space.high, parameters), space.feasible_low > 0

"""Steps of a fit's values within their bounds; what is positive moves in proportion.

within = bounds.limited(values, step)
values = bounds.moved(values, within)
step = shorter(step, within)                    # if that was refused
"""

from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Mask, Vector

_FACTOR = 2.0  # logarithm of the factor by which a positive value changes at most in a step
_WHOLE = 1 - 1e-9  # of a step, or of a way to a bound, but for rounding


@dataclass(frozen=True)
class Bounds:
    """The least and the largest values (p,), and which of them move in proportion."""

    low: Vector
    high: Vector
    positive: Mask

    def limited(self, values: Vector, step: Vector) -> Vector:
        """A step to the bounds, and by a factor of e² at most."""
        safe = np.where(self.positive, values, 1.0)
        least, most = self._ways(values)
        least = np.where(self.positive, np.maximum(least, -_FACTOR * safe), least)
        most = np.where(self.positive, np.minimum(most, _FACTOR * safe), most)
        return np.clip(step, least, most)

    def moved(self, values: Vector, step: Vector) -> Vector:
        """The values after a step, at a bound to the last bit if it leads there."""
        factor = np.exp(np.where(self.positive, step / np.where(self.positive, values, 1.0), 0.0))
        after = np.where(self.positive, values * factor, values + step)
        to_low, to_high = self._ways(values)
        is_low, is_high = step <= _WHOLE * to_low, step >= _WHOLE * to_high
        return np.where(is_low, self.low, np.where(is_high, self.high, after))

    def leaving(self, values: Vector, step: Vector, is_near: Mask) -> Mask:
        """True where a value at a bound, or near the lower one, would be moved beyond it."""
        below = (is_near | (values <= self.low)) & (values + step < self.low)
        return below | ((values >= self.high) & (step > 0))

    def _ways(self, values: Vector) -> tuple[Vector, Vector]:
        """Steps that lead from values to their bounds."""
        safe = np.where(self.positive, values, 1.0)

        def way(end: Vector) -> Vector:
            factor = np.where(self.positive, end, 1.0) / safe
            return np.where(self.positive, safe * np.log(factor), end - values)

        return way(self.low), way(self.high)


def shorter(step: Vector, within: Vector) -> Vector:
    """A step of all values in its direction, as far as the one `within` bounds goes in each; half
    of it, if it is within them itself."""
    cut = (np.abs(within) < _WHOLE * np.abs(step)) & (within != 0)
    return step * np.min(within[cut] / step[cut]) if cut.any() else step / 2

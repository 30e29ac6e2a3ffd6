"""Array roles, rows and columns; shapes are stated where an array is made."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Array3 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]


def frozen(values: Any) -> NDArray[np.float64]:
    """A read-only, contiguous float64 copy of `values`."""
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


def column_scales(values: Matrix) -> Vector:
    """Standard deviations of the columns, (n, d) -> (d,), and 1 where all values are equal."""
    # rounding of the mean gives equal values a deviation of about 1e-17
    return np.where(np.ptp(values, axis=0) > 0, values.std(axis=0), 1.0)


def spans(episodes: Indices) -> list[tuple[int, int]]:
    """Half-open row ranges of the episodes, from the episode id of every row (N,)."""
    edges = [0, *(np.flatnonzero(np.diff(episodes)) + 1).tolist(), len(episodes)]
    return [(first, last) for first, last in pairwise(edges) if last > first]

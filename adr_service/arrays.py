"""Names for the array roles used everywhere; shapes stand where an array is made."""

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

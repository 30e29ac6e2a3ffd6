"""How far positions have come since each of the rows before, which effects in sensors may ask."""

import numpy as np

from adr_service.arrays import Indices, Matrix, Vector
from adr_service.effects.base import Past

_REMEMBERED = 32  # rows


def along(path: Matrix) -> Past:
    """The past of all states of a path (rows, 2 nv) but the first."""
    return lambda column: since(path[:, column], np.zeros(len(path), dtype=np.int64))[1:]


def since(come: Vector, first: Indices) -> Matrix:
    """(rows, k) how far each row of a path (rows,) is from each of those before it, as far back as
    the row `first` (rows,)."""
    before = np.arange(len(come))[:, None] - np.arange(1, _REMEMBERED + 1)
    return come[:, None] - come[np.maximum(before, first[:, None])]

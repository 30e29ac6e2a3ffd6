"""Displacements of positions since each of the rows before, for sensors' effects with memory."""

import numpy as np

from adr_service.arrays import Indices, Matrix, Vector
from adr_service.effects.base import Past

_REMEMBERED = 32  # rows


def past_along(path: Matrix) -> Past:
    """The displacements of all states of a path (rows, 2 nv) but the first, by column."""
    return lambda column: displacements(path[:, column], np.zeros(len(path), dtype=np.int64))[1:]


def displacements(positions: Vector, first: Indices) -> Matrix:
    """(rows, k) how far each of the positions (rows,) is from each of those before it, the latest
    first, as far back as the row `first` (rows,)."""
    before = np.arange(len(positions))[:, None] - np.arange(1, _REMEMBERED + 1)
    return positions[:, None] - positions[np.maximum(before, first[:, None])]

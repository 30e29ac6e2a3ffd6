"""Displacements of positions since each of the moments before, for sensors' effects with memory.

A position's path between two rows is the cubic that has its velocities at both; without velocities
it is straight.
"""

import numpy as np

from adr_service.arrays import Indices, Matrix, Vector
from adr_service.effects.base import Past

WITHIN = 4  # moments of a row
_REMEMBERED = 32  # rows


def within(moved: Vector, before: Vector | None, after: Vector | None) -> Matrix:
    """Distances (n, WITHIN) that a position has covered at each moment of n steps, from begin to
    end.

    `moved` (n,): in the whole step. `before`, `after` (n,): its velocities at both ends times the
    period; None: it moves at one velocity.
    """
    part = np.arange(1, WITHIN + 1) / WITHIN
    if before is None or after is None:
        return moved[:, None] * part
    rises = (part**2 * (3 - 2 * part), part * (1 - part) ** 2, part**2 * (part - 1))
    weights = np.stack([moved, before, after], axis=1)
    return weights @ np.stack(rises)


def past_along(path: Matrix, period: float) -> Past:
    """The displacements of all states of a path (rows, 2 nv), a period [s] apart, but the first, by
    column."""

    def past(column: int) -> Matrix:
        pace = path[:, path.shape[1] // 2 + column] * period
        moved = within(np.diff(path[:, column]), pace[:-1], pace[1:])
        return displacements(moved, np.zeros(len(path), dtype=np.int64))[1:]

    return past


def displacements(come: Matrix, first: Indices) -> Matrix:
    """Distances (rows, k) of each row's position from that at each of the moments before it, the
    latest first, as far back as the row `first` (rows,).

    `come` (rows - 1, WITHIN): distances that it has covered at each moment of the steps between.
    """
    begun = np.concatenate([[0.0], np.cumsum(come[:, -1])])
    path = np.concatenate([[0.0], (begun[:-1, None] + come).ravel()])
    rows = WITHIN * np.arange(len(begun))
    before = rows[:, None] - np.arange(1, WITHIN * _REMEMBERED + 1)
    return path[rows][:, None] - path[np.maximum(before, WITHIN * first[:, None])]

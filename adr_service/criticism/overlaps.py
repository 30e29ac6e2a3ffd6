"""Rows that two recordings share, and that would count twice.

check_apart(["first.npz", "second.npz"], [first, second])
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from adr_service.arrays import Indices, Matrix
from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput

LEAST_SHARED = 10  # rows in a row
_SAME = 1e-9  # of the largest change: changes as near as that are the same


@dataclass(frozen=True)
class Overlap:
    """Two recordings, and the rows from which on they are the same."""

    first: int  # number of a recording
    first_row: int
    second: int
    second_row: int


def overlap(recordings: Sequence[tuple[Matrix, Indices]]) -> Overlap | None:
    """The first `LEAST_SHARED` rows that two recordings have in common; None if there are none.

    Each recording is its rows (n, k) and the numbers of those with which such a stretch may begin.
    """
    earlier: dict[int, tuple[int, int]] = {}  # recording and row, by the hash of a stretch
    for number, (rows, starts) in enumerate(recordings):
        exact = np.ascontiguousarray(rows + 0.0)  # -0.0 is 0.0
        own = {
            hash(exact[row : row + LEAST_SHARED].tobytes()): (number, row)
            for row in starts[::-1].tolist()  # of equal stretches the first one stays
        }
        if shared := [own[key] + earlier[key] for key in own.keys() & earlier.keys()]:
            second, second_row, first, first_row = min(shared)
            return Overlap(first, first_row, second, second_row)
        earlier.update(own)
    return None


def check_apart(names: Sequence[str], recordings: Sequence[Measurement]) -> None:
    """Raise InvalidInput if two recordings share rows, by what was measured and by the commands.

    Rows count in which no change of the readings occurs twice: a robot that rests or turns steadily
    shows the same to a coarse sensor in every recording.
    """
    if len(recordings) > 1 and (both := overlap([_rows_of(each) for each in recordings])):
        raise InvalidInput(
            f"{names[both.first]} from row {both.first_row} on and {names[both.second]} from row "
            f"{both.second_row} on are the same; give each row of a recording once"
        )


def _rows_of(data: Measurement) -> tuple[Matrix, Indices]:
    readings = np.hstack([data.qpos, data.qvel])[:, data.is_measured()]
    rows, steps = np.hstack([readings, data.ctrl]), np.diff(readings, axis=0)
    if len(rows) < LEAST_SHARED:
        return rows, np.arange(0)
    rounded = np.round(steps / (_SAME * np.max(np.abs(steps), initial=0.0) or 1.0))
    kinds = np.unique(rounded, axis=0, return_inverse=True)[1]
    stretches = np.sort(sliding_window_view(kinds, LEAST_SHARED - 1), axis=1)
    return rows, np.flatnonzero(np.all(np.diff(stretches, axis=1) > 0, axis=1))

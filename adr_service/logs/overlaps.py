"""Rows that two logs share, and that would count twice."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Indices, Matrix
from adr_service.criticism.overlaps import LEAST_SHARED, overlap
from adr_service.errors import InvalidInput
from adr_service.logs.base import Log, Stream
from adr_service.logs.mapping import LogMap


@dataclass(frozen=True)
class _Table:
    """The complete rows of a stream whose readings are not those of the row before."""

    source: str
    stream: Stream
    numbers: Indices  # (n,) of the rows in the stream
    rows: Matrix  # (n, k) times, readings and commands

    def place(self, row: int) -> str:
        return f"{self.source} from {self.stream.place(int(self.numbers[row]))} on"


def check_logs_apart(logs: Sequence[Log], given: LogMap) -> None:
    """Raise InvalidInput if two logs share rows, by their times and the columns of the map.

    Rows count whose readings change: a robot may rest in one place at the beginning of every log.
    """
    joints, drives = given.joints.values(), given.actuators.values()
    states = {name for joint in joints for name in (joint.position, joint.velocity) if name}
    commands = {drive.command for drive in drives if drive.command} - states
    alike: dict[tuple[str, ...], list[_Table]] = defaultdict(list)  # by their columns
    for log in logs:
        for stream in log.streams:
            if read := sorted(states & set(stream.columns)):
                sent = sorted(commands & set(stream.columns))
                table = _table(log.source, stream, read, sent, given.time.column)
                alike[*read, *sent].append(table)
    for tables in alike.values():
        starts = [np.arange(len(table.rows) - LEAST_SHARED + 1) for table in tables]
        both = overlap([(table.rows, s) for table, s in zip(tables, starts, strict=True)])
        if both is not None:
            one, other = tables[both.first], tables[both.second]
            raise InvalidInput(
                f"{one.place(both.first_row)} and {other.place(both.second_row)} have the same "
                "times and readings; give each row of a recording once"
            )


def _table(
    source: str, stream: Stream, read: Sequence[str], sent: Sequence[str], clock: str
) -> _Table:
    stamps = stream.stamps_beside(clock)
    time = stream.columns[clock] if stamps is None else stamps
    rows = np.column_stack([*(stream.columns[name] for name in (*read, *sent)), time])
    complete = np.flatnonzero(np.isfinite(rows).all(axis=1))
    changes = np.diff(rows[complete, : len(read)], axis=0, prepend=np.nan)
    numbers = complete[(changes != 0).any(axis=1)]
    return _Table(source, stream, numbers, rows[numbers])

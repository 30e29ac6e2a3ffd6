"""A log as its file has it: named columns of numbers, each with the times of its readings.

    (log,) = read_logs(Path("run1.csv"))
    log.names                                   # every column
    log.signal("q1", Clock("time", "s"))        # times [s] and values

Columns that share their rows make a stream: a table is one stream, every topic of a bag is another.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from adr_service.arrays import Indices, Vector
from adr_service.errors import InvalidInput, UnknownName

UNKNOWN = "?"  # of a drafted map, for a column that nobody named yet
MOST_NUMBERS = 2**25  # in all columns of a log: 256 MB, and some 2 GB while a bag is read
MOST_COLUMNS = 4096
MOST_BYTES = 2**30  # of a file, and of what it unpacks to
HOW_TO_SHRINK = "keep only the joints' states and commands, or cut the recording"
_CROWDED = 0.5  # of the usual spacing: readings closer than that are as good as one
_LEAST = 2  # readings of a column

TimeUnit = Literal["s", "ms", "us", "ns"]
SECONDS: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
STAMPS = (("sec", "nanosec"), ("sec", "nsec"), ("secs", "nsecs"))  # fields of ROS 2, 1 and JSON


@dataclass(frozen=True)
class Clock:
    """The column with the times of a table's rows, or of the messages of a bag's topic."""

    column: str = "time"
    unit: TimeUnit = "s"
    nanoseconds: str | None = None  # the column to add, where the other has whole seconds


@dataclass(frozen=True)
class Signal:
    """Readings of one column, in order of time."""

    time: Vector  # (n,) [s], increasing
    value: Vector  # (n,) in the log's unit
    crowded: int = 0  # readings that were left out because others came too soon before, or at once
    shared: int = 0  # of these, readings at the very time of another
    timeless: int = 0  # readings that were left out because their rows have no time
    has_arrivals: bool = False  # True if times are those at which a bag received them


@dataclass(frozen=True)
class Stream:
    """Columns that share their rows."""

    columns: Mapping[str, Vector]  # (n,) by name; NaN where the log has no number
    stamps: Vector | None = None  # (n,) [s] times of the rows, where the format states them
    has_arrivals: bool = False  # True if these are the times at which a bag received the messages
    dated: frozenset[str] = frozenset()  # columns of dates, which are in seconds since 1970
    before: int = 0  # rows of the log before these

    def of_rows(self, rows: slice) -> "Stream":
        """The stream of some of its rows."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        stamps = None if self.stamps is None else self.stamps[rows]
        return replace(self, columns=columns, stamps=stamps, before=self.before + rows.start)

    def stamps_beside(self, clock: str) -> Vector | None:
        """The rows' times [s] by the format; None where a column, the clock, has them."""
        return None if clock in self.columns else self.stamps

    def place(self, row: int) -> str:
        """The place of a row in the log, as its user counts: from 1."""
        number = self.before + row + 1
        return f"row {number} below the header" if self.stamps is None else f"message {number}"


@dataclass(frozen=True)
class Log:
    """One recording."""

    source: str  # the file's name
    streams: tuple[Stream, ...]
    unread: Mapping[str, str] = field(default_factory=dict[str, str])  # why, by column

    @property
    def rows(self) -> int:
        """Rows of the longest stream."""
        return max(len(v) for stream in self.streams for v in stream.columns.values())

    @property
    def names(self) -> list[str]:
        """Names of all columns of numbers."""
        return [name for stream in self.streams for name in stream.columns]

    def signal(self, column: str, clock: Clock) -> Signal:
        """The readings of a column; rows in which it has none (NaN) are left out, and counted where
        they have a reading and no time.

        Of those that come too soon after another the first is kept. Raises InvalidInput if there is
        no such column, if a reading is infinite, if its time runs backwards, and if fewer than two
        are left.
        """
        return self._kept(column, clock, _far_enough, _LEAST)

    def commands(self, column: str, clock: Clock) -> Signal:
        """The commands of a column; each holds until the next one comes.

        Of those that came at one time the last is kept. Raises InvalidInput as `signal` does, but
        one command is enough.
        """
        return self._kept(column, clock, _last_of_each, 1)

    def _kept(
        self, column: str, clock: Clock, keep: Callable[[Vector], Indices], least: int
    ) -> Signal:
        stream = self._stream_of(column)
        stamps = stream.stamps_beside(clock.column)
        if stamps is not None and clock.column not in (Clock.column, *self.names):
            raise self._no_column(clock.column, self.names)
        time = self._times(stream, clock) if stamps is None else stamps
        value = stream.columns[column]
        self._check_finite(stream, column)
        rows = np.flatnonzero(np.isfinite(value) & np.isfinite(time))
        timeless = int(np.isfinite(value).sum()) - len(rows)
        time, value = time[rows], value[rows]
        if (back := np.flatnonzero(np.diff(time) < 0)).size:
            row = int(back[0])
            raise InvalidInput(
                f"{self.source}: the time of column {column!r} goes back by "
                f"{time[row] - time[row + 1]:.6g} s at {stream.place(int(rows[row + 1]))}; "
                f"{_one_each(stream)}"
            )
        has_arrivals = stream.has_arrivals and stamps is not None
        kept = keep(time)
        if len(kept) < least:
            raise InvalidInput(
                f"{self.source}: column {column!r} has {len(kept)} readings with a time of their "
                f"own; needed: {least} or more"
            )
        shared = len(time) - len(np.unique(time))
        crowded = len(time) - len(kept)
        return Signal(time[kept], value[kept], crowded, shared, timeless, has_arrivals)

    def parts(self, column: str) -> list["Log"]:
        """One log for each stretch of rows with one value of a column, such as a trial's number.

        Raises InvalidInput if there are several streams, because nothing says which rows of another
        stream belong to which part.
        """
        stream = self._stream_of(column)
        if len(self.streams) > 1:
            raise InvalidInput(
                f"{self.source}: rows.episode is for tables; the topics of a bag share no rows. "
                "Give one bag for each recording, and leave rows.episode out"
            )
        value = stream.columns[column]
        if not len(value):
            raise InvalidInput(f"{self.source} has no rows; needed are readings below the header")
        if (missing := np.flatnonzero(~np.isfinite(value))).size:
            raise InvalidInput(
                f"{self.source}: {column!r} of rows.episode has no finite number at "
                f"{stream.place(int(missing[0]))} ({missing.size} rows in all); delete rows that "
                "belong to no recording"
            )
        edges = [0, *(np.flatnonzero(np.diff(value) != 0) + 1).tolist(), len(value)]
        return [
            Log(
                f"{self.source}, {column} {value[first]:g}",
                (stream.of_rows(slice(first, last)),),
                self.unread,
            )
            for first, last in pairwise(edges)
        ]

    def _stream_of(self, column: str) -> Stream:
        for stream in self.streams:
            if column in stream.columns:
                return stream
        raise self._no_column(column, self.names)

    def _no_column(self, column: str, names: list[str]) -> InvalidInput:
        if column in self.unread:
            return InvalidInput(
                f"{self.source}: column {column!r} has no numbers to read: {self.unread[column]}"
            )
        if column == UNKNOWN:
            return InvalidInput(
                f"{UNKNOWN!r} is what a draft has where it did not know the column; give one of "
                f"those in {self.source}: {', '.join(names)}"
            )
        unknown = UnknownName(f"column in {self.source}", column, names)
        if parents := [n for n in self.unread if column.startswith((f"{n}.", f"{n}_"))]:
            parent = max(parents, key=len)
            return InvalidInput(
                f"{self.source}: {parent!r} cannot be read: {self.unread[parent]}; {unknown}"
            )
        return unknown

    def _check_finite(self, stream: Stream, column: str) -> None:
        if (rows := np.flatnonzero(np.isinf(stream.columns[column]))).size:
            raise InvalidInput(
                f"{self.source}: column {column!r} has {rows.size} infinite readings, the first at "
                f"{stream.place(int(rows[0]))}; leave such cells empty, or give NaN, which is no "
                "reading"
            )

    def _times(self, stream: Stream, clock: Clock) -> Vector:
        if clock.column not in stream.columns:
            raise self._no_column(clock.column, list(stream.columns))
        self._check_finite(stream, clock.column)
        size = 1.0 if clock.column in stream.dated else SECONDS[clock.unit]
        times = stream.columns[clock.column] * size
        rest = nanoseconds_beside(clock.column, list(stream.columns))
        is_whole = bool(np.all(times[np.isfinite(times)] % 1 == 0))
        if clock.nanoseconds is None and rest is not None and is_whole:
            raise InvalidInput(
                f"{self.source}: {clock.column!r} has whole seconds, and {rest!r} the rest of the "
                f"times; give time.nanoseconds = {rest!r} as well"
            )
        if clock.nanoseconds is None:
            return times
        return times + self._times(stream, Clock(clock.nanoseconds, "ns"))


def nanoseconds_beside(column: str, names: Sequence[str]) -> str | None:
    """The column with the nanoseconds to those whole seconds, by its name; None without one."""
    for whole, rest in STAMPS:
        beside = column.removesuffix(whole) + rest
        if column.endswith(whole) and beside in names:
            return beside
    return None


def _one_each(stream: Stream) -> str:
    """Advice where another recording begins."""
    if stream.stamps is not None:
        return "give one bag for each recording"
    return (
        "give one file for each recording, or name a column under rows.episode that changes where "
        "another recording begins; sort the rows by time if these are late ones"
    )


def _far_enough(time: Vector) -> Indices:
    """Numbers of the readings that come at least half a usual spacing after the one kept before.

    An interpolation between readings that nearly coincide multiplies their noise.
    """
    if len(time) < 2:
        return np.arange(len(time))
    least = _CROWDED * float(np.median(np.diff(np.unique(time)))) if np.ptp(time) > 0 else 0.0
    kept = [0]
    for number, moment in enumerate(time[1:].tolist(), start=1):
        if moment - time[kept[-1]] > least:
            kept.append(number)
    return np.array(kept)


def _last_of_each(time: Vector) -> Indices:
    """Numbers of the readings after which a later one comes, or none."""
    return np.flatnonzero(np.diff(time, append=np.inf) > 0)


def check_size(source: str, columns: int, numbers: int) -> None:
    """Raises InvalidInput for a log with more than a criticism could use."""
    if columns > MOST_COLUMNS or numbers > MOST_NUMBERS:
        raise InvalidInput(
            f"{source} has {columns:,} columns and {numbers:,} numbers; accepted are "
            f"{MOST_COLUMNS:,} columns and {MOST_NUMBERS:,} numbers ({HOW_TO_SHRINK})"
        )


def check_bytes(source: str, size: int) -> None:
    """Raises InvalidInput for a log of more bytes than a criticism could use."""
    if size > MOST_BYTES:
        raise InvalidInput(
            f"{source} has {size:,} bytes; accepted are {MOST_BYTES:,} ({HOW_TO_SHRINK})"
        )

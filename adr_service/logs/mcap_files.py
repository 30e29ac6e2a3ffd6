"""MCAP bags, as ROS 2 records them: every topic is a stream.

A message's numbers become columns named by topic and field: `/imu.angular_velocity.x`. A list of
numbers becomes one column for each place: `/command.data_0`, and so do the fields of a list of
messages: `/low_state.motor_state_0.q`. Where the message names the places, as
`sensor_msgs/JointState` does, the column has that name: `/joint_states.position.shoulder`.
Times are the messages' own stamps (`header.stamp`, where it is not zero), or else when the bag
received them. A bag that was split into several files is read as one.
"""

import io
import json
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import AdrError, InvalidInput
from adr_service.logs.base import (
    HOW_TO_SHRINK,
    MOST_BYTES,
    MOST_NUMBERS,
    STAMPS,
    Log,
    Stream,
    check_size,
)

_DEEPEST, _LONGEST = 6, 256  # of nested fields; places of a list that are read
_WIDEST = 1024  # columns of a topic
_NAMES = ("name", "names", "joint_names")
# a message may arrive so much later than one that was sent after it, and so many of them in a row:
# more are of a clock that was set back
_LATE_S, _LATE = 1.0, 3


@dataclass
class _Topic:
    """Messages of one topic, so far."""

    stamps: list[float] = field(default_factory=list[float])  # NaN where there is none
    arrivals: list[float] = field(default_factory=list[float])
    columns: dict[str, dict[int, float]] = field(default_factory=dict[str, dict[int, float]])
    unread: dict[str, str] = field(default_factory=dict[str, str])  # why, by field

    @property
    def width(self) -> int:
        return len(self.columns) + len(self.unread)

    def add(
        self, stamp: float | None, arrived: float, values: Iterator[tuple[str, float | str]]
    ) -> int:
        """Add a message of numbers, and of reasons why fields have none; return how many."""
        row, count = len(self.stamps), 0
        self.stamps.append(stamp or np.nan)  # a stamp of zero was never set
        self.arrivals.append(arrived)
        for name, value in values:
            if isinstance(value, str):
                self.unread[name] = value
            else:
                self.columns.setdefault(name, {})[row] = value
            count += 1
        return count

    def stream(self) -> Stream:
        columns: dict[str, Vector] = {}
        for name, values in self.columns.items():
            columns[name] = np.full(len(self.stamps), np.nan)
            columns[name][list(values)] = list(values.values())
        stamps = np.array(self.stamps)
        has_arrivals = bool(np.all(np.isnan(stamps)))
        if has_arrivals:
            stamps = np.array(self.arrivals)
        order, known = np.arange(len(stamps)), stamps[np.isfinite(stamps)]
        # bags are in order of arrival; one that is early is a late one, read backwards
        if _are_late_ones(known) or _are_late_ones(-known[::-1]):
            order = np.argsort(stamps, kind="stable")
        ordered = {name: values[order] for name, values in columns.items()}
        return Stream(ordered, stamps[order], has_arrivals)


def _are_late_ones(stamps: Vector) -> bool:
    """True unless stamps (n,), in order of arrival, go back further than by late messages."""
    is_late = np.zeros(len(stamps) + 2, dtype=np.int64)
    is_late[2:-1] = stamps[1:] < np.maximum.accumulate(stamps)[:-1]
    ends = np.diff(is_late).nonzero()[0].reshape(-1, 2)
    longest = np.diff(ends, axis=1).max(initial=0)
    return bool(longest <= _LATE and np.all(np.diff(stamps) > -_LATE_S))


@dataclass
class _Bag:
    """Messages of all topics, so far."""

    source: str
    topics: dict[str, _Topic] = field(default_factory=dict[str, _Topic])
    unread: dict[str, str] = field(default_factory=dict[str, str])  # why, by topic
    too_wide: set[str] = field(default_factory=set[str])  # topics
    count: int = 0  # numbers

    def add(self, topic: str, decoded: Any, arrived: float) -> None:
        """Add a message. Raises InvalidInput for more than a criticism could use."""
        stamp = _get(_get(decoded, "header"), "stamp")
        if stamp is not None and (stamp := _seconds(stamp)) is None:
            self.unread[topic] = "its header.stamp has no sec and nanosec"
            return
        messages = self.topics.setdefault(topic, _Topic())
        self.count += messages.add(stamp, arrived, _flat(topic, decoded))
        if messages.width > _WIDEST:
            self.too_wide.add(topic)
            self.unread[topic] = f"it has more than {_WIDEST:,} columns"
            del self.topics[topic]
        if self.count > MOST_NUMBERS:
            check_size(self.source, 0, self.count)

    def log(self) -> Log:
        topics = self.topics.values()
        check_size(self.source, sum(len(topic.columns) for topic in topics), self.count)
        unread = dict(self.unread)
        for topic in topics:
            unread |= topic.unread
        return Log(self.source, tuple(topic.stream() for topic in topics), unread)


def read_mcap(source: str, content: bytes) -> Log:
    """The log of a bag. Raises InvalidInput for damaged ones, and if `mcap` is not installed."""
    return read_split_mcap(source, [(source, content)])


def read_split_mcap(source: str, parts: Iterable[tuple[str, bytes]]) -> Log:
    """The log of a bag in several files, given as names and contents in order of time.

    Raises InvalidInput as `read_mcap` does, with the name of the damaged part.
    """
    bag = _Bag(source)
    for name, content in parts:
        try:
            _add_part(bag, name, content)
        except AdrError:
            raise
        except Exception as error:  # parsers of damaged messages raise anything
            raise InvalidInput(f"{name} is no bag that can be read: {_reason(error)}") from error
    return bag.log()


def _reason(error: Exception) -> str:
    """Reason why a bag cannot be read, in words."""
    if type(error).__name__ == "EndOfFile" or isinstance(error, struct.error):
        return "it is cut short, as by a recorder that was killed; `mcap recover` may save it"
    return str(error) or repr(error)


def _add_part(bag: _Bag, name: str, content: bytes) -> None:
    try:
        from mcap.reader import SeekingReader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise InvalidInput(
            f"bags need a package: pip install 'adr-service[mcap]' ({error})"
        ) from error
    ros = DecoderFactory()
    decoders: dict[int, Callable[[bytes], Any] | None] = {}
    reader = SeekingReader(io.BytesIO(content), validate_crcs=True, record_size_limit=MOST_BYTES)
    _check_unpacked(name, content)
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if channel.topic in bag.too_wide:
            continue
        if channel.id not in decoders:
            decoders[channel.id] = _decoder(ros, channel.message_encoding, schema)
        decode = decoders[channel.id]
        if decode is None:
            how = f"by a schema in {schema.encoding!r}" if schema else "without a schema"
            bag.unread[channel.topic] = (
                f"its messages are in {channel.message_encoding!r}, {how}; accepted are those of "
                "'ros2msg', and JSON"
            )
            continue
        bag.add(channel.topic, decode(message.data), message.log_time * 1e-9)


def _check_unpacked(source: str, content: bytes) -> None:
    """Raises InvalidInput if the chunks announce more bytes than a criticism could use."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    reader = StreamReader(io.BytesIO(content), emit_chunks=True, record_size_limit=MOST_BYTES)
    unpacked = 0
    for record in reader.records:
        unpacked += record.uncompressed_size if isinstance(record, Chunk) else 0
        if unpacked > MOST_BYTES:
            raise InvalidInput(
                f"{source} unpacks to more than {MOST_BYTES:,} bytes ({HOW_TO_SHRINK})"
            )


def _decoder(ros: Any, encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
    """The function that decodes messages of an encoding, None if we know none."""
    if encoding == "json":
        return json.loads
    return ros.decoder_for(encoding, schema)


def _seconds(stamp: Any) -> float | None:
    """A stamp of ROS 2 or 1, or of JSON, in seconds; None if it is of another form."""
    for whole, rest in STAMPS:
        seconds, nanoseconds = _get(stamp, whole), _get(stamp, rest)
        if isinstance(seconds, int) and isinstance(nanoseconds, int):
            return seconds + 1e-9 * nanoseconds
    return None


def _flat(prefix: str, message: Any, depth: int = 0) -> Iterator[tuple[str, float | str]]:
    """Names and values of all numbers in a message, but for its header.

    Fields that are nested too deep or lists that are too long have the reason in place of values.
    """
    if depth > _DEEPEST:
        yield prefix, f"it is nested more than {_DEEPEST} fields deep"
        return
    named = next((names for n in _NAMES if (names := _get(message, n)) is not None), None)
    for name, value in _fields(message):
        path = f"{prefix}.{name}"
        if name == "header":
            continue
        if isinstance(value, bool | int | float):
            yield path, float(value)
        elif isinstance(value, list | tuple | np.ndarray | bytes):  # uint8[] comes as bytes
            values = cast(Any, value)
            if len(values) > _LONGEST:
                yield path, f"it is a list of {len(values):,} places; accepted are {_LONGEST}"
            else:
                yield from _places(path, list(values), named, depth)
        elif not isinstance(value, str | None):
            yield from _flat(path, value, depth + 1)


def _places(
    path: str, values: list[Any], names: Any, depth: int
) -> Iterator[tuple[str, float | str]]:
    if any(isinstance(value, list | tuple | np.ndarray | bytes) for value in values):
        yield path, "it is a list of lists"
        return
    is_named = isinstance(names, list | tuple) and len(cast(list[Any], names)) == len(values)
    is_named = is_named and len(set(map(str, names))) == len(values)  # two robots may share names
    for i, value in enumerate(values):
        place = f"{path}.{names[i]}" if is_named else f"{path}_{i}"
        if isinstance(value, bool | int | float | np.integer | np.floating):
            yield place, float(value)
        elif not isinstance(value, str | None):
            yield from _flat(place, value, depth + 1)


def _fields(message: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(message, dict):
        yield from cast(dict[str, Any], message).items()
    else:
        for name in getattr(message, "__slots__", ()):
            yield str(name).removeprefix("_"), getattr(message, name)


def _get(message: Any, name: str) -> Any:
    if isinstance(message, dict):
        return cast(dict[str, Any], message).get(name)
    return getattr(message, name, None)

"""Columns of a recording in the units and the order of a model, and checks of them."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from adr_service.arrays import Indices, Vector
from adr_service.criticism.compatibility import commanded_actuators, joints_of
from adr_service.criticism.plausibility import why_stuck
from adr_service.errors import InvalidInput
from adr_service.logs.base import Clock, Log, Signal
from adr_service.logs.mapping import LogMap, is_slide

LEAST_READINGS = 4  # in a window, for a parabola with an error of its own
PREFERRED = 8  # if the log's spacing decides the period, and a velocity is to be derived
LEAST_ROWS = 10  # of an episode
GAP = 3.0  # times the median spacing, from which on readings are missing
_OFTEN = 10.0  # times the spacing of readings, to which commands are frequent
SAME = 1e-6  # of a period: times as near as that are the same
DENSER = 0.7  # of a column's spacing: closer rows would count a reading more than once
TURN = 2 * np.pi
MANY_TURNS = 3  # of a joint, from which on its unit looks wrong
_SINCE_1970_S = 1e8  # stamps from which on they count from 1970
_COARSE = 3.0  # smallest steps of a sensor: larger changes are no single steps of a coarse one
_ROUNDED = 1e-9  # of a column's range: levels as near as that are the same
_NAMED = 4  # columns in a sentence
_LONG_S = 1.0  # period from which on the time's unit looks wrong
_FAR, _AGREE = 0.2, 0.02  # of a column's range, for a spike and for its two neighbours
_NOISE = 20.0  # times the median distance of a reading from the mean of its neighbours
_COMMON = 0.1  # share of a column's readings, from which on their stamps look coarse


@dataclass(frozen=True)
class Track:
    """Readings of one column in the model's units."""

    column: str
    quantity: str
    signal: Signal
    is_fitted: bool = False  # by parabolas, for a velocity
    way: str = ""  # of a command between readings

    @property
    def spacing(self) -> float:
        """Median time between readings [s]."""
        return float(np.median(np.diff(self.signal.time)))

    @property
    def after_gaps(self) -> Indices:
        """Numbers of the readings before which others are missing."""
        return np.flatnonzero(np.diff(self.signal.time) > GAP * self.spacing) + 1

    def stretches(self) -> list[Vector]:
        """The values between gaps, in the model's units."""
        return np.split(self.signal.value, self.after_gaps)

    def gaps(self) -> list[tuple[float, float]]:
        """The last time before each gap, and the first after it [s]."""
        time = self.signal.time
        return [(float(time[i - 1]), float(time[i])) for i in self.after_gaps]


@dataclass(frozen=True)
class Recording:
    """One recording, in the model's order."""

    source: str
    positions: list[Track]
    velocities: list[Track | None]  # None: derived, or not measured
    commands: list[Track | None]  # None: constant

    @property
    def states(self) -> list[Track]:
        return [*self.positions, *(track for track in self.velocities if track is not None)]

    @property
    def tracks(self) -> list[Track]:
        """States, and the commands that are no constants."""
        return [*self.states, *(track for track in self.commands if track is not None)]

    @property
    def frequent_commands(self) -> list[Track]:
        """Commands that come as often as readings of the states, so that a pause shows a gap.

        Others come when something changes, and hold in between.
        """
        usual = _OFTEN * max(track.spacing for track in self.states)
        known = [track for track in self.commands if track is not None]
        return [t for t in known if len(t.signal.time) > 1 and t.spacing <= usual]

    def gaps(self) -> list[tuple[float, float]]:
        tracks = [*self.states, *self.frequent_commands]
        return sorted({gap for track in tracks for gap in track.gaps()})

    def stretches(self) -> list[tuple[float, float]]:
        """Times without a gap, from the first command on."""
        commands = [track for track in self.commands if track is not None]
        begin = max(track.signal.time[0] for track in [*self.states, *commands])
        ends = [track.signal.time[-1] for track in self.states]
        ends += [t.signal.time[-1] + GAP * t.spacing for t in self.frequent_commands]
        end = min(ends)
        found: list[tuple[float, float]] = []
        for first, last in [*self.gaps(), (end, end)]:
            if min(first, end) > begin:
                found.append((float(begin), float(min(first, end))))
            begin = max(begin, last)
        return found


def recording_of(log: Log, given: LogMap, model: mujoco.MjModel) -> Recording:
    """The columns that a map names. Raises InvalidInput for those that cannot be used."""
    positions: list[Track] = []
    velocities: list[Track | None] = []
    for name in joints_of(model):
        joint, slide = given.joints[name], is_slide(model, name)
        position = _track(log.signal, given, joint.position, f"{name}.position", joint.zero)
        position = scaled(position, joint.position_factor(slide))
        positions.append(replace(position, is_fitted=joint.derive_velocity))
        velocity = None
        if joint.velocity is not None:
            velocity = _track(log.signal, given, joint.velocity, f"{name}.velocity", 0.0)
            velocity = scaled(velocity, joint.velocity_factor(slide))
        velocities.append(velocity)
    commands: list[Track | None] = []
    for name in commanded_actuators(model):
        drive, command = given.actuators[name], None
        if drive.command is not None:
            read = log.commands if drive.between == "hold" else log.signal
            command = _track(read, given, drive.command, f"{name}.command", drive.zero)
            command = replace(scaled(command, drive.factor, drive.delay), way=drive.between)
        commands.append(command)
    known = [track for track in (*positions, *velocities, *commands) if track is not None]
    start = min(track.signal.time[0] for track in known)
    start = start if start > _SINCE_1970_S else 0.0  # seconds of the recording are easier to read

    def since(track: Track | None) -> Track | None:
        return None if track is None else scaled(track, 1.0, -start)

    return Recording(
        log.source,
        [scaled(track, 1.0, -start) for track in positions],
        [since(track) for track in velocities],
        [since(track) for track in commands],
    )


def _track(
    read: Callable[[str, Clock], Signal], given: LogMap, column: str, quantity: str, zero: float
) -> Track:
    try:
        signal = read(column, given.time.clock)
    except InvalidInput as error:
        raise InvalidInput(f"{quantity}: {error}") from error
    return Track(column, quantity, replace(signal, value=signal.value - zero))


def scaled(track: Track, factor: float, delay: float = 0.0) -> Track:
    signal = track.signal
    later = replace(signal, time=signal.time + delay, value=factor * signal.value)
    return replace(track, signal=later)


def check_moves(recordings: Sequence[Recording]) -> None:
    """Raises InvalidInput for a sensor that never changes in any recording, or that saturates.

    Readings before the first stretch become no rows, and do not count.
    """
    begins = [next(iter(each.stretches()), (np.inf, np.inf))[0] for each in recordings]
    for tracks in zip(*(each.states for each in recordings), strict=True):
        parts = [
            track.signal.value[track.signal.time >= begin]
            for track, begin in zip(tracks, begins, strict=True)
        ]
        values = np.concatenate(parts)
        if len(values) >= LEAST_ROWS and (why := why_stuck(values)) is not None:
            quantity = tracks[0].quantity
            remedy = _remedy(quantity, is_constant=bool(np.ptp(values) == 0))
            raise InvalidInput(f"column {tracks[0].column!r} ({quantity}) {why}; {remedy}")


def _remedy(quantity: str, is_constant: bool) -> str:
    """The map or the model to change where the readings of a sensor cannot be used."""
    joint, _, kind = quantity.rpartition(".")
    if kind == "velocity" and is_constant:
        return f"so it is no velocity; leave joints.{joint}.velocity out (not measured)"
    needed = "needed are readings that follow the robot"
    if not is_constant:
        needed += ". If it only rests there, cut out rows in which it does (rows.episode)"
    if kind == "velocity":
        return needed
    return (
        f"{needed}. If {joint} stays put, as a closed gripper does, delete it and its actuators in "
        "the model, which welds its body at the pose of the file, and delete their tables in the "
        "map"
    )


def repeated(recordings: Sequence[Recording]) -> Iterator[str]:
    """Warnings of columns in which rows repeat the readings of a slower sensor.

    Most of their readings stay for two rows or more. A coarse encoder does that too, but its
    changes are single steps. A joint that rests stays for long, but changes in every row later.
    """
    for tracks in zip(*(each.states for each in recordings), strict=True):
        changes = [np.flatnonzero(np.diff(track.signal.value)) + 1 for track in tracks]
        stays = np.concatenate([np.diff(rows) for rows in changes])
        if not len(stays) or np.median(stays) < 2:
            continue
        both = list(zip(tracks, changes, strict=True))
        jumps = [np.abs(t.signal.value[rows] - t.signal.value[rows - 1]) for t, rows in both]
        levels = np.diff(np.unique(np.concatenate([track.signal.value for track in tracks])))
        least = levels[levels > _ROUNDED * levels.sum()].min()
        if np.median(np.concatenate(jumps)) <= _COARSE * least:
            continue
        spacing = np.median(np.concatenate([np.diff(t.signal.time[rows]) for t, rows in both]))
        yield (
            f"column {tracks[0].column!r} changes every {1000 * spacing:.3g} ms only, and rows "
            f"repeat its readings every {1000 * tracks[0].spacing:.3g} ms; its sensor seems to be "
            "slower than the log. A repeated reading counts as a new one: leave it out (an empty "
            "cell is no reading)"
        )


def shared_times(recordings: Sequence[Recording]) -> Iterator[str]:
    """Warnings of columns in which many readings have one time, one for all that are alike."""
    alike: dict[tuple[int, int], list[str]] = defaultdict(list)  # names, by shared and by all
    for tracks in zip(*(each.tracks for each in recordings), strict=True):
        shared = sum(track.signal.shared for track in tracks)
        readings = sum(len(track.signal.time) + track.signal.crowded for track in tracks)
        if shared > _COMMON * readings:
            alike[shared, readings].append(tracks[0].column)
    for (shared, readings), columns in alike.items():
        yield (
            f"{shared} of {readings} readings of {_listed(columns)} have the time of the one "
            "before; of one time the first reading is kept, or the last command, so coarse stamps "
            "drop readings and shift commands. Log finer ones"
        )


def left_out_readings(recordings: Sequence[Recording]) -> Iterator[str]:
    """Warnings of columns that lose many readings for other reasons than equal times."""
    for tracks in zip(*(each.tracks for each in recordings), strict=True):
        signals = [track.signal for track in tracks]
        crowded = sum(signal.crowded - signal.shared for signal in signals)
        timeless = sum(signal.timeless for signal in signals)
        readings = sum(len(each.time) + each.crowded + each.timeless for each in signals)
        if crowded + timeless > _COMMON * readings:
            yield (
                f"{crowded + timeless} of {readings} readings of {tracks[0].column!r} are left "
                f"out: {crowded} come less than half the usual spacing after the one before, as "
                f"where two sources log one column, and {timeless} have no time"
            )


def spikes(recordings: Sequence[Recording]) -> Iterator[str]:
    """Warnings of columns with single readings far off two neighbours that agree.

    Far off is a fifth of the range, more than noise reaches, and more than single steps of a coarse
    sensor.
    """
    for tracks in zip(*(each.states for each in recordings), strict=True):
        levels = np.unique(np.concatenate([track.signal.value for track in tracks]))
        steps = np.diff(levels)
        if not (steps > _ROUNDED * steps.sum()).any():
            continue
        least = float(steps[steps > _ROUNDED * steps.sum()].min())
        off = [np.abs(np.diff(track.signal.value, n=2)) / 2 for track in tracks]
        noise = float(np.median(np.concatenate(off)))
        far = max(_FAR * float(steps.sum()), _NOISE * noise, _COARSE * least)
        found: list[float] = []
        for track, each in zip(tracks, off, strict=True):
            value = track.signal.value
            agree = np.abs(value[2:] - value[:-2]) < _AGREE * steps.sum()
            found += track.signal.time[1:-1][(each > far) & agree].tolist()
        if found:
            yield (
                f"column {tracks[0].column!r} is far off the readings before and after, which "
                f"agree, {len(found)} times, first at {found[0]:.6g} s; leave these cells empty if "
                "the robot did not move like that"
            )


def mixed_clocks(recordings: Sequence[Recording]) -> Iterator[str]:
    """Warnings of bags in which some columns have stamps of their own and others arrivals."""
    for recording in recordings:
        arrived = [t.column for t in recording.tracks if t.signal.has_arrivals]
        stamped = [t.column for t in recording.tracks if not t.signal.has_arrivals]
        if arrived and stamped:
            yield (
                f"{recording.source} has two clocks: times of their own for "
                f"{_listed(stamped)}, and the time of arrival in the bag for {_listed(arrived)}. "
                "What is at arrival seems late; record its messages with a header, or give the "
                "actuators a delay (negative if their commands are at arrival)"
            )


def _listed(columns: Sequence[str]) -> str:
    """Names of columns in a sentence."""
    more = f" and {len(columns) - _NAMED} more" * (len(columns) > _NAMED)
    return ", ".join(map(repr, columns[:_NAMED])) + more


def bursts(recording: Recording) -> Iterator[str]:
    """Sentences on columns whose readings come a few at once, as by a slow network."""
    for track in (*recording.states, *recording.frequent_commands):
        pauses = len(track.gaps())
        size = len(track.signal.time) / (pauses + 1)
        if pauses and size < LEAST_ROWS:
            yield (
                f"column {track.column!r} comes in bursts of about {size:.0f} readings, "
                f"{1000 * track.spacing:.3g} ms apart: its stamps seem to be times of arrival, so "
                "give those of the sensor (time.column; for a bag, a field of the same topic)"
            )


def check_lengths(
    recordings: Sequence[Recording], period: float, given: LogMap, step: float
) -> None:
    """Raises InvalidInput for episodes or rows that are too short, and for clocks that differ.

    A period is a multiple of `step` [s], the model's own.
    """
    if period > _LONG_S:
        raise InvalidInput(f"rows would be {period:.3g} s apart; is time.unit right?")
    if given.rows.seconds < LEAST_ROWS * period:
        raise InvalidInput(
            f"rows.seconds is {given.rows.seconds:g}; an episode needs {LEAST_ROWS} rows, which "
            f"are {period:g} s apart (if they should be nearer, is time.unit right?)"
        )
    for recording in recordings:
        for track in recording.states:
            if period < DENSER * track.spacing:
                raise InvalidInput(
                    f"{recording.source}: rows {period:g} s apart are more than the readings of "
                    f"{track.column!r}, {track.spacing:.3g} s apart; give rows.period = "
                    f"{_whole_steps(track.spacing, step):.6g} or more"
                )
        last, first = (
            max(recording.tracks, key=lambda track: track.signal.time[0]),
            min(recording.states, key=lambda track: track.signal.time[-1]),
        )
        if last.signal.time[0] >= first.signal.time[-1]:
            raise InvalidInput(
                f"{recording.source}: {last.column!r} begins at {last.signal.time[0]:.6g} s, after "
                f"{first.column!r} has ended at {first.signal.time[-1]:.6g} s; do both have the "
                "same clock?"
            )


def check_derived(recording: Recording, period: float, step: float) -> None:
    """Raises InvalidInput if a velocity is to be derived from readings that are too few for it.

    A period is a multiple of `step` [s], the model's own.
    """
    for track in recording.positions:
        if track.is_fitted and period < LEAST_READINGS * track.spacing * (1 - SAME):
            name = track.quantity.removesuffix(".position")
            raise InvalidInput(
                f"joints.{name}: no velocity can be derived from readings {track.spacing:.3g} s "
                f"apart for rows {period:g} s apart, because a row needs {LEAST_READINGS} of its "
                f"own; give rows.period = {_whole_steps(PREFERRED * track.spacing, step):.6g} or "
                "so, or leave derive_velocity out (not measured)"
            )


def _whole_steps(seconds: float, step: float) -> float:
    """The shortest time of whole steps that is at least as long."""
    return float(np.ceil(seconds / step - SAME) * step)

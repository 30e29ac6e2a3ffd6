"""Resample logs to even times, in SI units, and cut them into episodes.

A state is what a cubic spline through all readings has at the time of a row. A joint whose velocity
is to be derived has a window about each row instead, as long as the period, with four readings at
least: its position is the value of the parabola that fits them best, by least squares, and its
velocity the slope. Few readings are in two windows (those next to a window that has fewer than four
of its own), so the errors of different rows are nearly independent.
(In one row, those of position and velocity are uncorrelated if the readings lie evenly about the
middle.) A parabola smooths what changes within a window, so windows should be short.

A command holds until the next one comes, or moves in a straight line to it. A row has its mean over
each of the model's steps until the next row.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import mujoco
import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from adr_service.arrays import Array3, Indices, Matrix, Vector
from adr_service.criticism.compatibility import check_state
from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput
from adr_service.logs.base import Log, Signal
from adr_service.logs.mapping import JointMap, LogMap, actuators_of, is_slide, joints_of

_LEAST_READINGS = 4  # in a window, for a parabola with an error of its own
_PREFERRED = 8  # if the log's spacing decides the period, and a velocity is to be derived
_SINCE_1970_S = 1e8  # stamps from which on they count from 1970
_MANY_TURNS, _BEYOND = 3, 0.1  # turns of a joint; of its range
_LONG_S, _SHORT_S = 1.0, 2.0  # period and recordings, from which on the time's unit looks wrong
_ROUNDED = 0.05  # of the readings' spacing
_DENSER = 0.7  # of a column's spacing: closer rows would count a reading more than once
_GAP = 3.0  # times the median spacing, from which on readings are missing
_LEAST_ROWS = 10  # of an episode
_TURN, _NEARLY = 2 * np.pi, 0.1  # a jump by a turn, to within a tenth
_SAME = 1e-6  # of a period: times as near as that are the same
_TO_STD = 1.4826  # from the median of absolute deviations to a standard deviation


@dataclass(frozen=True)
class Column:
    """How one column was read."""

    name: str  # of the log
    quantity: str  # shoulder.position, motor.command, …
    readings: int
    crowded: int  # readings that came too soon after the one before, left out
    spacing: tuple[float, float, float]  # [s] smallest, median, largest
    reach: tuple[float, float]  # in the model's units
    way: str  # parabola, spline, hold or line
    # robust deviation of a reading [model's units] from the cubic through its four neighbours, as
    # if all of it were noise, and at least that of the reading's steps; NaN for a command
    scatter: float


@dataclass(frozen=True)
class Record:
    """What came of one log."""

    source: str
    columns: tuple[Column, ...]
    gaps: tuple[tuple[float, float], ...]  # [s] first and last time of each
    seconds: float  # of the log
    seconds_left_out: float  # in gaps and at ends too short for an episode


@dataclass(frozen=True)
class Converted:
    """A measurement, and how it came about."""

    measurement: Measurement
    period: float  # [s]
    records: tuple[Record, ...]
    at_limit: Mapping[str, float]  # share of rows at a limit or beyond, by actuator with limits
    warnings: tuple[str, ...]  # what looks wrong, and is not refused
    noise: Vector  # (2 nv,) deviations of positions and velocities by the scatter of readings; NaN:
    # not measured


@dataclass(frozen=True)
class _Track:
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

    def gaps(self) -> list[tuple[float, float]]:
        time = self.signal.time
        wide = np.flatnonzero(np.diff(time) > _GAP * self.spacing)
        return [(float(time[i]), float(time[i + 1])) for i in wide]


@dataclass(frozen=True)
class _Recording:
    """One recording, in the model's order."""

    source: str
    positions: list[_Track]
    velocities: list[_Track | None]  # None: derived, or not measured
    commands: list[_Track | None]  # None: constant

    @property
    def states(self) -> list[_Track]:
        return [*self.positions, *(track for track in self.velocities if track is not None)]

    def gaps(self) -> list[tuple[float, float]]:
        return sorted({gap for track in self.states for gap in track.gaps()})

    def stretches(self) -> list[tuple[float, float]]:
        """Times without a gap in any state, from the first command on."""
        commands = [track for track in self.commands if track is not None]
        begin = max(track.signal.time[0] for track in [*self.states, *commands])
        end = min(track.signal.time[-1] for track in self.states)
        found: list[tuple[float, float]] = []
        for first, last in [*self.gaps(), (end, end)]:
            if min(first, end) > begin:
                found.append((float(begin), float(min(first, end))))
            begin = max(begin, last)
        return found


@dataclass(frozen=True)
class _Episode:
    time: Vector  # (n,)
    qpos: Matrix  # (n, nq)
    qvel: Matrix  # (n, nv)
    ctrl: Array3  # (n, steps of the model in a row, nu)


def convert(logs: Sequence[Log], given: LogMap, model: mujoco.MjModel) -> Converted:
    """The measurement of a robot that a model describes, from its logs.

    Raises InvalidInput with the column or the setting to change, if there is nothing to measure.
    """
    check_state(model)
    given.check(model)
    column = given.rows.episode
    parts = [part for log in logs for part in ([log] if column is None else log.parts(column))]
    recordings = [_recording(log, given, model) for log in parts]
    _check_velocities(recordings)
    period = _period(recordings, given, model)
    _check_lengths(recordings, period, given)
    episodes: list[_Episode] = []
    records: list[Record] = []
    noise: list[Vector] = []
    for recording in recordings:
        _check_derived(recording, period)
        pieces = _pieces(recording, period, given.rows.seconds)
        episodes += [_episode(recording, piece, period, given, model) for piece in pieces]
        records.append(_record(recording, pieces, period))
        noise.append(_noise(recording, period))
    if not episodes:
        raise InvalidInput(
            f"no stretch without a gap is {_LEAST_ROWS} rows of {period:g} s long; give a smaller "
            "rows.period, or a log with fewer gaps"
        )
    joined = _joined(episodes, given, model)
    limits = _at_limit(model, np.concatenate([each.ctrl for each in episodes]))
    warnings = tuple(_warnings(joined, period, recordings, given, model))
    return Converted(joined, period, tuple(records), limits, warnings, np.median(noise, axis=0))


def _warnings(
    data: Measurement,
    period: float,
    recordings: Sequence[_Recording],
    given: LogMap,
    model: mujoco.MjModel,
) -> Iterator[str]:
    """Sentences on what is possible but looks wrong."""
    for number, name in enumerate(joints_of(model)):
        joint = model.joint(name)
        low, high = data.qpos[:, number].min(), data.qpos[:, number].max()
        if not is_slide(model, name) and high - low > _MANY_TURNS * _TURN:
            yield (
                f"{name} turns {(high - low) / _TURN:.0f} times; is joints.{name}.unit right "
                f"({given.joints[name].unit or 'rad'})?"
            )
        least, most = joint.range
        slack = _BEYOND * (most - least)
        if joint.limited[0] and (low < least - slack or high > most + slack):
            yield (
                f"{name} goes from {low:.3g} to {high:.3g}, and the model's range is {least:.3g} "
                f"to {most:.3g}; are unit, scale and zero of joints.{name} right?"
            )
    spacing = max(track.spacing for each in recordings for track in each.positions)
    if (
        given.rows.period is None
        and abs(period / spacing - 1) > _ROUNDED
        and not any(joint.derive_velocity for joint in given.joints.values())
    ):
        yield (
            f"rows are {1000 * period:g} ms apart and readings {1000 * spacing:.3g} ms, because "
            f"rows are whole steps of the model, of {1000 * model.opt.timestep:g} ms"
        )
    for name in actuators_of(model):
        actuator = model.actuator(name)
        if not actuator.ctrllimited[0]:
            yield (
                f"{name} has no ctrlrange in the model: a command of 1 counts as its largest, by "
                "which sensible sizes of friction and the like are judged"
            )


def _recording(log: Log, given: LogMap, model: mujoco.MjModel) -> _Recording:
    positions: list[_Track] = []
    velocities: list[_Track | None] = []
    for name in joints_of(model):
        joint, slide = given.joints[name], is_slide(model, name)
        position = _track(log, given, joint.position, f"{name}.position", joint.zero)
        position = _scaled(_unwrapped(position, joint), joint.position_factor(slide))
        position = replace(position, is_fitted=joint.derive_velocity)
        if not slide:
            _check_wraps(log, name, position)
        positions.append(position)
        velocity = None
        if joint.velocity is not None:
            velocity = _track(log, given, joint.velocity, f"{name}.velocity", 0.0)
            velocity = _scaled(velocity, joint.velocity_factor(slide))
        velocities.append(velocity)
    commands: list[_Track | None] = []
    for name in actuators_of(model):
        drive, command = given.actuators[name], None
        if drive.command is not None:
            command = _track(log, given, drive.command, f"{name}.command", drive.zero)
            command = replace(_scaled(command, drive.factor, drive.delay), way=drive.between)
        commands.append(command)
    known = [track for track in (*positions, *velocities, *commands) if track is not None]
    start = min(track.signal.time[0] for track in known)
    start = start if start > _SINCE_1970_S else 0.0  # seconds of the recording are easier to read

    def since(track: _Track | None) -> _Track | None:
        return None if track is None else _scaled(track, 1.0, -start)

    return _Recording(
        log.source,
        [_scaled(track, 1.0, -start) for track in positions],
        [since(track) for track in velocities],
        [since(track) for track in commands],
    )


def _track(log: Log, given: LogMap, column: str, quantity: str, zero: float) -> _Track:
    try:
        signal = log.signal(column, given.time.clock)
    except InvalidInput as error:
        raise InvalidInput(f"{quantity}: {error}") from error
    return _Track(column, quantity, replace(signal, value=signal.value - zero))


def _scaled(track: _Track, factor: float, delay: float = 0.0) -> _Track:
    signal = track.signal
    later = replace(signal, time=signal.time + delay, value=factor * signal.value)
    return replace(track, signal=later)


def _unwrapped(track: _Track, joint: JointMap) -> _Track:
    if joint.wrap is None:
        return track
    value = np.unwrap(track.signal.value, period=joint.wrap)
    return replace(track, signal=replace(track.signal, value=value))


def _check_wraps(log: Log, joint: str, position: _Track) -> None:
    time, jumps = position.signal.time, np.abs(np.diff(position.signal.value))
    is_near = np.diff(time) <= _GAP * position.spacing
    if (turns := np.flatnonzero(is_near & (np.abs(jumps - _TURN) < _NEARLY * _TURN))).size:
        raise InvalidInput(
            f"{log.source}: column {position.column!r} jumps by a turn at "
            f"{time[turns[0] + 1]:.6g} s; if its readings wrap around, give joints.{joint}.wrap, "
            "the size of a turn in them (360 for degrees)"
        )


def _check_velocities(recordings: Sequence[_Recording]) -> None:
    """Raises InvalidInput for a velocity that is the same in all recordings."""
    for tracks in zip(*(each.velocities for each in recordings), strict=True):
        known = [track for track in tracks if track is not None]
        values = [value for track in known for value in track.signal.value[[0, -1]]]
        if known and np.ptp(values) == 0 and all(np.ptp(t.signal.value) == 0 for t in known):
            joint = known[0].quantity.removesuffix(".velocity")
            raise InvalidInput(
                f"column {known[0].column!r} is {values[0]:g} throughout, so it is no velocity; "
                f"leave joints.{joint}.velocity out (not measured)"
            )


def _check_lengths(recordings: Sequence[_Recording], period: float, given: LogMap) -> None:
    """Raises InvalidInput for episodes or rows that are too short, and for clocks that differ."""
    if period > _LONG_S:
        raise InvalidInput(f"rows would be {period:.3g} s apart; is time.unit right?")
    if given.rows.seconds < _LEAST_ROWS * period:
        raise InvalidInput(
            f"rows.seconds is {given.rows.seconds:g}; an episode needs {_LEAST_ROWS} rows, which "
            f"are {period:g} s apart"
        )
    for recording in recordings:
        for track in recording.states:
            if period < _DENSER * track.spacing:
                raise InvalidInput(
                    f"{recording.source}: rows {period:g} s apart are more than the readings of "
                    f"{track.column!r}, {track.spacing:.3g} s apart; give rows.period = "
                    f"{track.spacing:.3g} or more"
                )
        tracks = [*recording.states, *(track for track in recording.commands if track is not None)]
        last, first = (
            max(tracks, key=lambda track: track.signal.time[0]),
            min(recording.states, key=lambda track: track.signal.time[-1]),
        )
        if last.signal.time[0] >= first.signal.time[-1]:
            raise InvalidInput(
                f"{recording.source}: {last.column!r} begins at {last.signal.time[0]:.6g} s, after "
                f"{first.column!r} has ended at {first.signal.time[-1]:.6g} s; do both have the "
                "same clock?"
            )


def _period(recordings: Sequence[_Recording], given: LogMap, model: mujoco.MjModel) -> float:
    """Seconds between rows: the map's, or what the log has, in whole steps of the model."""
    step = float(model.opt.timestep)
    if (asked := given.rows.period) is not None:
        if abs(asked / step - max(round(asked / step), 1)) > 1e-3:
            raise InvalidInput(
                f"rows.period is {asked:g} s, which is no multiple of the model's step of {step:g} "
                "s; change one of the two"
            )
        return asked
    spacing = max(track.spacing for each in recordings for track in each.states)
    if any(joint.derive_velocity for joint in given.joints.values()):
        spacing *= _PREFERRED
    return max(round(spacing / step), 1) * step


def _check_derived(recording: _Recording, period: float) -> None:
    """Raises InvalidInput if a velocity is to be derived from readings that are too few for it."""
    for track in recording.positions:
        if track.is_fitted and period < _LEAST_READINGS * track.spacing * (1 - _SAME):
            name = track.quantity.removesuffix(".position")
            raise InvalidInput(
                f"joints.{name}: no velocity can be derived from readings {track.spacing:.3g} s "
                f"apart for rows {period:g} s apart, because a row needs {_LEAST_READINGS} of its "
                f"own; give rows.period = {_PREFERRED * track.spacing:.2g} or so, or leave "
                "derive_velocity out (not measured)"
            )


def _pieces(recording: _Recording, period: float, seconds: float) -> list[Vector]:
    """Times of the rows of each episode, all of a stretch as long, about `seconds`."""
    # a window at the end of a stretch would have half of its readings
    margin = period / 2 if any(track.is_fitted for track in recording.states) else 0.0
    pieces: list[Vector] = []
    for begin, end in recording.stretches():
        rows = int((end - begin - 2 * margin) / period + _SAME) + 1
        count = max(round(rows * period / seconds), 1)
        length = rows // count
        if length < _LEAST_ROWS:
            continue
        grid = begin + margin + period * np.arange(count * length, dtype=np.float64)
        pieces += list(grid.reshape(count, length))
    return pieces


def _episode(
    recording: _Recording, time: Vector, period: float, given: LogMap, model: mujoco.MjModel
) -> _Episode:
    positions: list[Vector] = []
    velocities: list[Vector] = []
    for position, velocity in zip(recording.positions, recording.velocities, strict=True):
        value, slope = _sampled(position, time, period)
        positions.append(value)
        velocities.append(slope if velocity is None else _sampled(velocity, time, period)[0])
    steps = round(period / model.opt.timestep)
    commands = np.empty((len(time), steps, len(recording.commands)))
    for number, name in enumerate(actuators_of(model)):
        command = recording.commands[number]
        if command is None:
            commands[..., number] = given.actuators[name].constant
        else:
            mean = _held if command.way == "hold" else _interpolated
            commands[..., number] = mean(command.signal, _edges(time, period, steps)).reshape(
                len(time), steps
            )
    return _Episode(time, np.column_stack(positions), np.column_stack(velocities), commands)


def _sampled(track: _Track, centres: Vector, period: float) -> tuple[Vector, Vector]:
    """Values and slopes at the centres (n,)."""
    if track.is_fitted:
        return _parabolas(track.signal, centres, period)
    time, value = track.signal.time, track.signal.value
    # the readings of this stretch, and none beyond a gap
    edges = [edge for gap in track.gaps() for edge in gap]
    begin = max([edge for edge in edges if edge <= centres[0]], default=-np.inf)
    end = min([edge for edge in edges if edge >= centres[-1]], default=np.inf)
    own = (time >= begin) & (time <= end)
    spline = CubicSpline(time[own], value[own])
    return spline(centres), spline(centres, 1)


def _parabolas(signal: Signal, centres: Vector, period: float) -> tuple[Vector, Vector]:
    values, slopes = np.empty(len(centres)), np.empty(len(centres))
    for row, (first, last) in enumerate(_windows(signal, centres, period)):
        # in units of half a period, for the numbers' sake
        near = (signal.time[first:last] - centres[row]) / (period / 2)
        shape = np.vander(near, 3, increasing=True)
        fitted = np.linalg.lstsq(shape, signal.value[first:last], rcond=None)[0]
        values[row], slopes[row] = fitted[0], fitted[1] / (period / 2)
    return values, slopes


def _windows(signal: Signal, centres: Vector, period: float) -> list[tuple[int, int]]:
    """Half-open ranges of the readings in each window; one that has too few gets the nearest."""
    edges = np.append(centres - period / 2, centres[-1] + period / 2)
    numbers = np.searchsorted(signal.time, edges).tolist()
    return [_widened(first, last, len(signal.time)) for first, last in pairwise(numbers)]


def _widened(first: int, last: int, count: int) -> tuple[int, int]:
    while last - first < min(_LEAST_READINGS, count):
        first, last = max(first - 1, 0), min(last + 1, count)
    return first, last


def _edges(time: Vector, period: float, steps: int) -> Vector:
    """(n steps + 1,) where each of so many steps of each row begins, and where the last ends."""
    parts = period / steps * np.arange(steps)
    return np.append((time[:, None] + parts).ravel(), time[-1] + period)


def _held(signal: Signal, edges: Vector) -> Vector:
    """Mean between neighbouring edges of a command that holds until the next one comes."""
    lasting = np.diff(signal.time, append=max(edges[-1], signal.time[-1]))
    area = np.concatenate([[0.0], np.cumsum(signal.value * lasting)])
    number = _number_at(signal.time, edges)
    until = area[number] + signal.value[number] * (edges - signal.time[number])
    return np.diff(until) / np.diff(edges)


def _interpolated(signal: Signal, edges: Vector) -> Vector:
    """Mean between neighbouring edges of a command that moves in straight lines."""
    area = cumulative_trapezoid(signal.value, signal.time, initial=0.0)
    number = _number_at(signal.time, edges)
    value = np.interp(edges, signal.time, signal.value)
    until = area[number] + (signal.value[number] + value) / 2 * (edges - signal.time[number])
    return np.diff(until) / np.diff(edges)


def _number_at(times: Vector, moments: Vector) -> Indices:
    """The number of the last of some times (n,) before each moment, or of the first."""
    return np.maximum(np.searchsorted(times, moments, side="right") - 1, 0)


def _record(recording: _Recording, pieces: Sequence[Vector], period: float) -> Record:
    columns = [
        _column(track, "parabola" if track.is_fitted else "spline") for track in recording.states
    ]
    columns += [_column(track, track.way) for track in recording.commands if track is not None]
    times = [track.signal.time for track in recording.states]
    seconds = float(max(time[-1] for time in times) - min(time[0] for time in times))
    kept = period * sum(map(len, pieces))
    return Record(
        recording.source,
        tuple(columns),
        tuple(recording.gaps()),
        seconds,
        max(seconds - kept, 0.0),
    )


def _column(track: _Track, way: str) -> Column:
    time, value = track.signal.time, track.signal.value
    steps = np.diff(time)
    return Column(
        track.column,
        track.quantity,
        len(time),
        track.signal.crowded,
        (float(steps.min()), float(np.median(steps)), float(steps.max())),
        (float(value.min()), float(value.max())),
        way,
        _scatter(track) if way in ("parabola", "spline") else np.nan,
    )


def _scatter(track: _Track) -> float:
    """`Column.scatter`."""
    time, value = track.signal.time, track.signal.value
    own = np.arange(2, len(time) - 2)
    own = own[time[own + 2] - time[own - 2] <= _GAP * 4 * track.spacing]
    if not len(own):
        return np.nan
    near = own[:, None] + np.array([-2, -1, 1, 2])
    away = (time[near] - time[own][:, None]) / track.spacing  # (k, 4)
    # Lagrange's weights of the neighbours at the reading: prod_j t_j / (t_j - t_i), j other than i
    apart = away[:, None, :] - away[:, :, None]
    factors = np.divide(away[:, None, :], apart, out=np.ones_like(apart), where=apart != 0)
    weights = factors.prod(axis=2)
    misses = value[own] - np.sum(weights * value[near], axis=1)
    single = misses / np.sqrt(1 + np.sum(weights**2, axis=1))
    levels = np.diff(np.unique(value))
    step = float(levels.min()) / np.sqrt(12) if len(levels) else 0.0
    return max(float(_TO_STD * np.median(np.abs(single))), step)


def _noise(recording: _Recording, period: float) -> Vector:
    """(2 nv,) deviations of rows, by the scatter of readings; NaN where nothing is measured."""
    positions, velocities = [], []
    for position, velocity in zip(recording.positions, recording.velocities, strict=True):
        scatter, count = _scatter(position), period / position.spacing
        # n readings in a window w, a parabola: value s sqrt(9 / 4n), slope s sqrt(12 / n) / w
        of_position = scatter * np.sqrt(9 / (4 * count)) if position.is_fitted else scatter
        slope = scatter * np.sqrt(12 / count) / period if position.is_fitted else np.nan
        positions.append(of_position)
        velocities.append(slope if velocity is None else _scatter(velocity))
    return np.array([*positions, *velocities])


def _joined(episodes: Sequence[_Episode], given: LogMap, model: mujoco.MjModel) -> Measurement:
    lengths = [len(each.time) for each in episodes]
    joints = [given.joints[name] for name in joints_of(model)]
    measured = [joint.velocity is not None or joint.derive_velocity for joint in joints]
    within = np.concatenate([each.ctrl for each in episodes])
    measurement = Measurement(
        time=np.concatenate([each.time for each in episodes]),
        qpos=np.concatenate([each.qpos for each in episodes]),
        qvel=np.concatenate([each.qvel for each in episodes]),
        ctrl=within.mean(axis=1),
        ctrl_within=within if _varies(within) else None,
        episode=np.repeat(np.arange(len(episodes)), lengths),
        qvel_std=None if all(measured) else np.where(measured, np.nan, np.inf),
    )
    seconds = sum(float(each.time[-1] - each.time[0]) for each in episodes)
    if seconds < _SHORT_S:
        raise InvalidInput(
            f"the recordings have {seconds:.3g} s in all, and ten or more are needed; is time.unit "
            "right?"
        )
    measurement.check_usable()
    measurement.check_velocities()
    return measurement


def _varies(within: Array3) -> bool:
    """True if some row's command changes by more than rounding."""
    return bool(np.ptp(within, axis=1).max(initial=0.0) > _SAME * np.abs(within).max(initial=0.0))


def _at_limit(model: mujoco.MjModel, within: Array3) -> dict[str, float]:
    """Share of rows with a command at a limit or beyond, from (N, steps, nu)."""
    shares: dict[str, float] = {}
    for number, name in enumerate(actuators_of(model)):
        actuator = model.actuator(name)
        if actuator.ctrllimited[0]:
            low, high = actuator.ctrlrange
            near = 1e-3 * (high - low)
            at = (within[..., number] <= low + near) | (within[..., number] >= high - near)
            shares[name] = float(at.any(axis=1).mean())
    return shares

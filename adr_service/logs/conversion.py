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
from dataclasses import dataclass

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.compatibility import check_state, commanded_actuators, joints_of
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.plausibility import check_rates, check_usable
from adr_service.effects.actuators import largest_force
from adr_service.errors import InvalidInput
from adr_service.logs.agreement import Agreement, agreements
from adr_service.logs.base import Log
from adr_service.logs.mapping import LogMap, is_servo, is_slide, joint_of
from adr_service.logs.overlaps import check_logs_apart
from adr_service.logs.resampling import edges, held, interpolated, sampled, scatter
from adr_service.logs.tracks import (
    DENSER,
    LEAST_ROWS,
    MANY_TURNS,
    PREFERRED,
    SAME,
    TURN,
    Recording,
    Track,
    bursts,
    check_derived,
    check_lengths,
    check_moves,
    left_out_readings,
    mixed_clocks,
    recording_of,
    repeated,
    shared_times,
    spikes,
)
from adr_service.logs.turns import (
    beside_their_joints,
    bridged,
    check_jumps,
    fast_turns,
    on_one_branch,
    unknown_turns,
    unnoticed_turns,
    unwrapped,
    wrapping_set_points,
)

_BEYOND = 0.1  # of a joint's range
_SHORT_S = 2.0  # fewer seconds of episodes are too few; of recordings, the unit looks wrong
_OFTEN = 0.2  # share of rows at a limit
_ROUNDED = 0.05  # of the readings' spacing
_MUCH = 0.2  # share of the logs' seconds


@dataclass(frozen=True)
class Column:
    """Conversion record of one column."""

    name: str  # of the log
    quantity: str  # shoulder.position, motor.command, …
    readings: int
    crowded: int  # readings that came too soon after the one before, left out
    timeless: int  # readings in rows without a time, left out
    spacing: tuple[float, float, float]  # [s] smallest, median, largest; NaN for one reading
    reach: tuple[float, float]  # in the model's units
    way: str  # parabola, spline, hold or line
    # robust deviation of a reading [model's units] from the cubic through its four neighbours, as
    # if all of it were noise, and at least that of the reading's steps; NaN for a command
    scatter: float


@dataclass(frozen=True)
class Record:
    """Conversion record of one log."""

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
    agreements: tuple[Agreement, ...]  # of the joints for which the data could be compared
    warnings: tuple[str, ...]  # what looks wrong, and is not refused
    noise: Vector  # (2 nv,) deviations of positions and velocities by the scatter of readings; NaN:
    # not measured


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
    parts, short = _parts(logs, given.rows.episode)
    recordings = [unwrapped(recording_of(part, given, model), given, model) for part in parts]
    check_logs_apart(logs, given)
    for recording in recordings:
        check_jumps(recording, given, model)
    recordings = on_one_branch(recordings, given, model)
    recordings = [beside_their_joints(recording, given, model) for recording in recordings]
    check_moves(recordings)
    period = _period(recordings, given, model)
    check_lengths(recordings, period, given, float(model.opt.timestep))
    episodes: list[_Episode] = []
    records: list[Record] = []
    noise: list[Vector] = []
    for recording in recordings:
        check_derived(recording, period, float(model.opt.timestep))
        pieces = _pieces(recording, period, given.rows.seconds)
        episodes += [_episode(recording, piece, period, given, model) for piece in pieces]
        records.append(_record(recording, pieces, period))
        if pieces:  # a recording that is too short for an episode has no scatter either
            noise.append(_noise(recording, period))
    if not episodes:
        hint = "give a smaller rows.period, or a log with fewer gaps"
        why = next((burst for each in recordings for burst in bursts(each)), hint)
        raise InvalidInput(
            f"no stretch without a gap is {LEAST_ROWS} rows of {period:g} s long; {why}"
        )
    joined = _joined(episodes, sum(each.seconds for each in records), given, model)
    compared = tuple(agreements(joined, model))
    limits = _at_limit(model, np.concatenate([each.ctrl for each in episodes]))
    warnings = (
        *(
            f"{part.source} is too short for an episode (rows: {part.rows}), and is left out"
            for part in short
        ),
        *bridged(recordings, given),
        *fast_turns(recordings, given, model),
        *unknown_turns(recordings, given, model),
        *wrapping_set_points(recordings, given, model),
        *unnoticed_turns(recordings, given, model),
        *mixed_clocks(recordings),
        *shared_times(recordings),
        *left_out_readings(recordings),
        *spikes(recordings),
        *repeated(recordings),
        *_left_out(records),
        *_warnings(joined, period, recordings, given, model, compared),
        *(
            f"{name}'s commands are at the model's limit or beyond in {share:.0%} of all rows; is "
            f"actuators.{name}.scale right?"
            for name, share in limits.items()
            if share > _OFTEN
        ),
    )
    typical = np.median(noise, axis=0)
    return Converted(joined, period, tuple(records), limits, compared, warnings, typical)


def _parts(logs: Sequence[Log], column: str | None) -> tuple[list[Log], list[Log]]:
    """Recordings by a column's value, and those with fewer rows than an episode needs.

    The short ones are left out, unless all are short.
    """
    if column is None:
        return list(logs), []
    parts = [part for log in logs for part in log.parts(column)]
    long = [part for part in parts if part.rows >= LEAST_ROWS]
    short = [part for part in parts if part.rows < LEAST_ROWS]
    return (long, short) if long else (parts, [])


def _left_out(records: Sequence[Record]) -> Iterator[str]:
    """A warning if a large share of the time became no rows."""
    seconds = sum(record.seconds for record in records)
    left_out = sum(record.seconds_left_out for record in records)
    if left_out > _MUCH * seconds:
        yield (
            f"{left_out:.3g} s of {seconds:.3g} s were left out: rows begin where every column "
            "has begun, and a gap in the readings of one column is a gap in all (the page lists "
            "them)"
        )


def _warnings(
    data: Measurement,
    period: float,
    recordings: Sequence[Recording],
    given: LogMap,
    model: mujoco.MjModel,
    compared: Sequence[Agreement],
) -> Iterator[str]:
    """Sentences on what is possible but looks wrong."""
    for number, name in enumerate(joints_of(model)):
        joint = model.joint(name)
        low, high = data.qpos[:, number].min(), data.qpos[:, number].max()
        if not is_slide(model, name) and high - low > MANY_TURNS * TURN:
            yield (
                f"{name} turns {(high - low) / TURN:.0f} times; is joints.{name}.unit right "
                f"({given.joints[name].unit or 'rad'})?"
            )
        least, most = joint.range
        slack = _BEYOND * (most - least)
        if joint.limited[0] and (low < least - slack or high > most + slack):
            yield (
                f"{name} goes from {low:.3g} to {high:.3g}, and the model's range is {least:.3g} "
                f"to {most:.3g}; are unit, scale and zero of joints.{name} right?"
            )
    yield from filter(None, (each.warning() for each in compared))
    blind = [name for name, joint in given.joints.items() if not joint.has_velocity]
    if blind and len(given.joints) > 1:
        yield (
            f"no velocity is measured of {', '.join(blind)}: a criticism then looks for one cause "
            "after the other, and not for several at once by the forces that the motion takes "
            "(that needs the velocities of all joints)"
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
    for name in commanded_actuators(model):
        actuator = model.actuator(name)
        if not actuator.ctrllimited[0]:
            yield (
                f"{name} has no ctrlrange in the model: a command of 1 counts as its largest, by "
                "which sensible sizes of friction and the like are judged"
            )
        if is_servo(model, name) and not _is_force_limited(model, name):
            yield (
                f"{name} is a servo without forcerange in the model, nor actuatorfrcrange at its "
                f"joint: its largest force counts as {largest_force(model, actuator.id):.3g} (N or "
                "N m), its gain times its largest command, by which sensible sizes of friction and "
                "the like are judged"
            )


def _is_force_limited(model: mujoco.MjModel, actuator: str) -> bool:
    """True if the actuator or the joint that it moves has a largest force."""
    joint = joint_of(model, actuator)
    at_joint = joint is not None and model.jnt_actfrclimited[model.joint(joint).id]
    return bool(at_joint or model.actuator(actuator).forcelimited[0])


def _period(recordings: Sequence[Recording], given: LogMap, model: mujoco.MjModel) -> float:
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
        spacing *= PREFERRED
    steps = max(round(spacing / step), 1)
    return (steps if steps * step >= DENSER * spacing else steps + 1) * step


def _pieces(recording: Recording, period: float, seconds: float) -> list[Vector]:
    """Times of the rows of each episode, all of a stretch as long, about `seconds`."""
    # a window at the end of a stretch would have half of its readings
    margin = period / 2 if any(track.is_fitted for track in recording.states) else 0.0
    pieces: list[Vector] = []
    for begin, end in recording.stretches():
        rows = int((end - begin - 2 * margin) / period + SAME) + 1
        if rows < LEAST_ROWS:
            continue
        count = min(max(round(rows * period / seconds), 1), rows // LEAST_ROWS)
        length = rows // count
        grid = begin + margin + period * np.arange(count * length, dtype=np.float64)
        pieces += list(grid.reshape(count, length))
    return pieces


def _episode(
    recording: Recording, time: Vector, period: float, given: LogMap, model: mujoco.MjModel
) -> _Episode:
    positions: list[Vector] = []
    velocities: list[Vector] = []
    for position, velocity in zip(recording.positions, recording.velocities, strict=True):
        value, slope = sampled(position, time, period)
        positions.append(value)
        velocities.append(slope if velocity is None else sampled(velocity, time, period)[0])
    steps = round(period / model.opt.timestep)
    commands = np.empty((len(time), steps, len(recording.commands)))
    for number, name in enumerate(commanded_actuators(model)):
        command = recording.commands[number]
        if command is None:
            commands[..., number] = given.actuators[name].constant
        else:
            mean = held if command.way == "hold" else interpolated
            commands[..., number] = mean(command.signal, edges(time, period, steps)).reshape(
                len(time), steps
            )
    return _Episode(time, np.column_stack(positions), np.column_stack(velocities), commands)


def _record(recording: Recording, pieces: Sequence[Vector], period: float) -> Record:
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


def _column(track: Track, way: str) -> Column:
    time, value = track.signal.time, track.signal.value
    steps = np.diff(time) if len(time) > 1 else np.array([np.nan])
    return Column(
        track.column,
        track.quantity,
        len(time),
        track.signal.crowded,
        track.signal.timeless,
        (float(steps.min()), float(np.median(steps)), float(steps.max())),
        (float(value.min()), float(value.max())),
        way,
        scatter(track) if way in ("parabola", "spline") else np.nan,
    )


def _noise(recording: Recording, period: float) -> Vector:
    """(2 nv,) deviations of rows, by the scatter of readings; NaN where nothing is measured."""
    positions, velocities = [], []
    for position, velocity in zip(recording.positions, recording.velocities, strict=True):
        spread, count = scatter(position), period / position.spacing
        # n readings in a window w, a parabola: value s sqrt(9 / 4n), slope s sqrt(12 / n) / w
        of_position = spread * np.sqrt(9 / (4 * count)) if position.is_fitted else spread
        slope = spread * np.sqrt(12 / count) / period if position.is_fitted else np.nan
        positions.append(of_position)
        velocities.append(slope if velocity is None else scatter(velocity))
    return np.array([*positions, *velocities])


def _joined(
    episodes: Sequence[_Episode], recorded: float, given: LogMap, model: mujoco.MjModel
) -> Measurement:
    """All episodes of so many recorded seconds."""
    lengths = [len(each.time) for each in episodes]
    joints = [given.joints[name] for name in joints_of(model)]
    measured = [joint.has_velocity for joint in joints]
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
        why = (
            "is time.unit right?"
            if recorded < _SHORT_S
            else f"of {recorded:.3g} s on record the rest is gaps, or too short for an episode"
        )
        raise InvalidInput(
            f"the episodes have {seconds:.3g} s in all, and ten or more are needed; {why}"
        )
    check_usable(measurement)
    try:
        check_rates(measurement)
    except InvalidInput as error:
        raise InvalidInput(
            f"{error}. Columns are joints in the model's order ({', '.join(joints_of(model))}); "
            "does the map have the right unit, scale, velocity_unit and velocity_scale for it?"
        ) from error
    return measurement


def _varies(within: Array3) -> bool:
    """True if some row's command changes by more than rounding."""
    return bool(np.ptp(within, axis=1).max(initial=0.0) > SAME * np.abs(within).max(initial=0.0))


def _at_limit(model: mujoco.MjModel, within: Array3) -> dict[str, float]:
    """Share of rows with a command at a limit or beyond, from (N, steps, nu)."""
    shares: dict[str, float] = {}
    for number, name in enumerate(commanded_actuators(model)):
        actuator = model.actuator(name)
        if actuator.ctrllimited[0]:
            low, high = actuator.ctrlrange
            near = 1e-3 * (high - low)
            at = (within[..., number] <= low + near) | (within[..., number] >= high - near)
            shares[name] = float(at.any(axis=1).mean())
    return shares

"""Readings that begin again at the end of a turn, as motions and set-points that go on.

A reading tells a position up to whole turns. Within a stretch the next reading is the nearest.
Across a gap the joint goes on at the speed that it has on both sides. Whole recordings are put on
one branch, and set-points next to their joint.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput
from adr_service.logs.mapping import JointMap, LogMap, actuators_of, is_slide, joint_of, joints_of
from adr_service.logs.tracks import GAP, MANY_TURNS, TURN, Recording, Track

_NEARLY = 0.1  # a jump by a turn, to within a tenth
_SPEED = 5  # readings beside a gap that tell the speed there


def on_one_branch(
    recordings: Sequence[Recording], given: LogMap, model: mujoco.MjModel
) -> list[Recording]:
    """Recordings in which the same pose has the same position, whichever turn a reading began in.

    The median of the first recording is put next to the middle of the joint's range (zero for one
    without limits), and the others' next to it. Set-points that wrap are put next to their joint.
    Raises InvalidInput for readings that jump by a turn, also with the map's `wrap`.
    """
    moved = list(recordings)
    for number, name in enumerate(joints_of(model)):
        joint, slide, near = given.joints[name], is_slide(model, name), 0.0
        turn = None if joint.wrap is None else abs(joint.position_factor(slide)) * joint.wrap
        if model.joint(name).limited[0]:
            near = float(np.mean(model.joint(name).range))
        for which, recording in enumerate(moved):
            track = recording.positions[number]
            if turn is not None:
                value = _unwrapped(track, turn)
                value += _turns(near - float(np.median(value)), turn)
                near = near if which else float(np.median(value))
                track = replace(track, signal=replace(track.signal, value=value))
                positions = [*recording.positions]
                positions[number] = track
                moved[which] = replace(recording, positions=positions)
            if not slide:
                _check_jumps(recording.source, name, track, joint)
    return [_beside_the_joint(recording, given, model) for recording in moved]


def _unwrapped(track: Track, turn: float) -> Vector:
    """Positions that go on where the readings begin again."""
    time, value = track.signal.time, np.unwrap(track.signal.value, period=turn)
    gaps = np.flatnonzero(np.diff(time) > GAP * track.spacing) + 1
    edges = [0, *gaps.tolist(), len(time)]
    for begin, gap, end in zip(edges, edges[1:], edges[2:], strict=False):
        before, after = slice(max(begin, gap - _SPEED), gap), slice(gap, min(end, gap + _SPEED))
        speed = np.mean([_speed(time[side], value[side]) for side in (before, after)])
        due = value[gap - 1] + speed * (time[gap] - time[gap - 1])
        value[gap:] += _turns(due - value[gap], turn)
    return value


def _check_jumps(source: str, name: str, position: Track, joint: JointMap) -> None:
    """Raises InvalidInput for readings that jump by a turn."""
    time, value = position.signal.time, position.signal.value
    jumps, is_near = np.abs(np.diff(value)), np.diff(time) <= GAP * position.spacing
    turns = np.flatnonzero(is_near & (np.abs(jumps - TURN) < _NEARLY * TURN))
    if not turns.size:
        return
    jumping = f"{source}: column {position.column!r} jumps by a turn at {time[turns[0] + 1]:.6g} s"
    if (whole := np.ptp(value) / TURN) > MANY_TURNS:
        raise InvalidInput(
            f"{jumping}, and goes through {whole:.0f} turns in all; is joints.{name}.unit right "
            f"({joint.unit or 'rad, because none is given'})?"
        )
    if joint.wrap is not None:
        raise InvalidInput(
            f"{jumping} also with joints.{name}.wrap = {joint.wrap:g}; that is the size of a turn "
            "in the readings' own unit: is it right?"
        )
    raise InvalidInput(
        f"{jumping}; if its readings wrap around, give joints.{name}.wrap, the size of a turn in "
        "them (360 for degrees)"
    )


def bridged(recordings: Sequence[Recording], given: LogMap) -> Iterator[str]:
    """Warnings of joints whose turns across a gap rest on their speed beside it."""
    for tracks in zip(*(each.positions for each in recordings), strict=True):
        name = tracks[0].quantity.removesuffix(".position")
        gaps = [gap for track in tracks for gap in track.gaps()]
        if given.joints[name].wrap is not None and gaps:
            longest = max(last - first for first, last in gaps)
            yield (
                f"{name}'s readings wrap, and have {len(gaps)} gaps, of {longest:.3g} s at most; "
                "its turns in them are guessed from its speed on both sides. If that may be wrong "
                "by half a turn, cut the log at its gaps (rows.episode)"
            )


def _speed(time: Vector, value: Vector) -> float:
    """Slope of the line through some readings; zero for one reading."""
    return float(np.polyfit(time - time[0], value, 1)[0]) if len(time) > 1 else 0.0


def _turns(away: float, turn: float) -> float:
    """The whole turns that are nearest to a distance."""
    return turn * round(away / turn)


def _beside_the_joint(recording: Recording, given: LogMap, model: mujoco.MjModel) -> Recording:
    """A recording with its set-points on the branch of the joint that they move."""
    commands = list(recording.commands)
    for number, name in enumerate(actuators_of(model)):
        drive, track, joint = given.actuators[name], commands[number], joint_of(model, name)
        if drive.wrap is None or track is None or joint is None:
            continue
        position = recording.positions[joints_of(model).index(joint)].signal
        time, value = track.signal.time, track.signal.value
        near = model.actuator(name).gear[0] * np.interp(time, position.time, position.value)
        turn = abs(drive.factor) * drive.wrap
        value = value + turn * np.round((near - value) / turn)
        commands[number] = replace(track, signal=replace(track.signal, value=value))
    return replace(recording, commands=commands)

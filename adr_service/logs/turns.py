"""Readings that begin again at the end of a turn, as motions and set-points that go on.

A reading tells a position up to whole turns. Within a stretch the next reading is the nearest.
Across a gap the joint goes on at the speed that it has on both sides. Whole recordings are put on
one branch, where that changes no pose, and set-points next to their joint.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.compatibility import commanded_actuators, joints_of
from adr_service.errors import InvalidInput
from adr_service.logs.mapping import JointMap, LogMap, is_servo, is_slide, joint_of
from adr_service.logs.tracks import GAP, MANY_TURNS, TURN, Recording, Track

_NEARLY = 0.1  # a jump by a turn, to within a tenth
_SPEED = 5  # readings beside a gap that tell the speed there
_ROUNDED = 1e-3  # of a turn: how near a size such as 6.28 must be to whole turns of a hinge
_FAST = 1 / 3  # of a turn between two readings; from half a turn on they are ambiguous
_TOOTH = 0.9  # of the range of all readings: a step back that is as good as all of it
_BESIDE = 3  # changes before and after such a step, in the other direction


def unwrapped(recording: Recording, given: LogMap, model: mujoco.MjModel) -> Recording:
    """A recording whose positions go on where their readings begin again."""
    positions = list(recording.positions)
    for number, turn in enumerate(_turns_of(given, model)):
        if turn is not None:
            value = _going_on(positions[number], turn)
            positions[number] = _with(positions[number], value)
    return replace(recording, positions=positions)


def check_jumps(recording: Recording, given: LogMap, model: mujoco.MjModel) -> None:
    """Raises InvalidInput for a hinge whose positions jump by a turn, with what to change."""
    for name, position in zip(joints_of(model), recording.positions, strict=True):
        if not is_slide(model, name):
            _check_hinge(recording.source, name, position, given.joints[name])


def on_one_branch(
    recordings: Sequence[Recording], given: LogMap, model: mujoco.MjModel
) -> list[Recording]:
    """Unwrapped recordings in which the same pose has the same position.

    A recording's median is put next to the middle of the joint's range. Where that is wider than a
    turn, or missing (then the middle is zero), this holds for the first recording, and the others'
    medians are put next to its. Joints whose pose a turn of their readings changes stay where their
    readings and their zero put them.
    """
    middles: dict[int, float] = {}  # of the first recording, by joint
    moved: list[Recording] = []
    for recording in recordings:
        positions = list(recording.positions)
        for number, turn in enumerate(_turns_of(given, model)):
            name = joints_of(model)[number]
            if turn is None or _changes_pose(turn, model, name):
                continue
            near = middles.get(number, _middle_of_range(model, name))
            value = positions[number].signal.value
            value = value + turn * np.round((near - np.median(value)) / turn)
            joint = model.joint(name)
            if not joint.limited[0] or np.ptp(joint.range) > turn * (1 + _ROUNDED):
                middles.setdefault(number, float(np.median(value)))
            positions[number] = _with(positions[number], value)
        moved.append(replace(recording, positions=positions))
    return moved


def beside_their_joints(recording: Recording, given: LogMap, model: mujoco.MjModel) -> Recording:
    """A recording with set-points that wrap on the branch of the joint that they move."""
    commands = list(recording.commands)
    for number, name in enumerate(commanded_actuators(model)):
        drive, track, joint = given.actuators[name], commands[number], joint_of(model, name)
        if drive.wrap is None or track is None or joint is None:
            continue
        position = recording.positions[joints_of(model).index(joint)].signal
        time, value = track.signal.time, track.signal.value
        near = model.actuator(name).gear[0] * np.interp(time, position.time, position.value)
        turn = abs(drive.factor) * drive.wrap
        commands[number] = _with(track, value + turn * np.round((near - value) / turn))
    return replace(recording, commands=commands)


def bridged(recordings: Sequence[Recording], given: LogMap) -> Iterator[str]:
    """Warnings of joints whose turns across a gap rest on their speed beside it."""
    for tracks in zip(*(each.positions for each in recordings), strict=True):
        name = tracks[0].quantity.removesuffix(".position")
        gaps = [gap for track in tracks for gap in track.gaps()]
        if given.joints[name].wrap is not None and gaps:
            longest = max(last - first for first, last in gaps)
            yield (
                f"{name}'s readings wrap, and have {len(gaps)} gaps, of {longest:.3g} s at most; "
                "its turns in them are guessed from its speed beside them. If that may be wrong "
                "by half a turn, cut the log at its gaps (rows.episode)"
            )


def fast_turns(
    recordings: Sequence[Recording], given: LogMap, model: mujoco.MjModel
) -> Iterator[str]:
    """Warnings of joints that move by nearly half a turn of their readings between two of them."""
    for number, (name, turn) in enumerate(
        zip(joints_of(model), _turns_of(given, model), strict=True)
    ):
        if turn is None:
            continue
        tracks = [each.positions[number] for each in recordings]
        inside = [np.diff(each) for track in tracks for each in track.stretches()]
        most = max(float(np.abs(steps).max(initial=0.0)) for steps in inside) / turn
        if most > _FAST:
            yield (
                f"{name} moves by up to {most:.2g} of a turn of its readings (joints.{name}.wrap) "
                "between two of them; from half a turn on it would be taken to move the other way. "
                "Log faster, or log the joint's own angle"
            )


def wrapping_set_points(
    recordings: Sequence[Recording], given: LogMap, model: mujoco.MjModel
) -> Iterator[str]:
    """Warnings of set-points without a wrap that jump by a turn."""
    for number, name in enumerate(commanded_actuators(model)):
        joint = joint_of(model, name)
        drive, tracks = given.actuators[name], [each.commands[number] for each in recordings]
        if joint is None or is_slide(model, joint) or not is_servo(model, name) or drive.wrap:
            continue
        turn = abs(model.actuator(name).gear[0]) * TURN
        known = [track for track in tracks if track is not None]
        jumps = [time for track in known for time in _jumps(track, turn)]
        if jumps:
            yield (
                f"column {known[0].column!r} jumps by a turn at {jumps[0]:.6g} s ({len(jumps)} "
                f"times in all); if its set-points wrap around, give actuators.{name}.wrap, and "
                f"joints.{joint}.wrap as well: the size of a turn in the joint's readings, also if "
                "these go on"
            )


def _jumps(track: Track, turn: float) -> list[float]:
    """Times of steps by about a turn."""
    steps = np.abs(np.diff(track.signal.value))
    return track.signal.time[1:][np.abs(steps - turn) < _NEARLY * turn].tolist()


def unknown_turns(
    recordings: Sequence[Recording], given: LogMap, model: mujoco.MjModel
) -> Iterator[str]:
    """Warnings of joints whose readings wrap in less or more than whole turns of the joint."""
    for name, turn in zip(joints_of(model), _turns_of(given, model), strict=True):
        if turn is None or not _changes_pose(turn, model, name):
            continue
        size = f"{turn:.3g} {'m' if is_slide(model, name) else 'rad, no whole turn of the joint'}"
        others = "; if only some recordings did, convert these on their own"
        yield (
            f"{name}'s readings wrap every {size}, so nothing in the log says in which of these a "
            "recording begins; each is taken to begin where its first reading says with "
            f"joints.{name}.zero. If the robot stood elsewhere, shift zero by multiples of "
            f"{given.joints[name].wrap:g}{others if len(recordings) > 1 else ''}"
        )


def unnoticed_turns(
    recordings: Sequence[Recording], given: LogMap, model: mujoco.MjModel
) -> Iterator[str]:
    """Warnings of joints without a wrap whose readings fall back like the teeth of a saw."""
    for number, name in enumerate(joints_of(model)):
        joint, tracks = given.joints[name], [each.positions[number] for each in recordings]
        reach = float(np.ptp(np.concatenate([track.signal.value for track in tracks])))
        if joint.wrap is not None or reach == 0:
            continue
        teeth = [time for track in tracks for time in _teeth(track, _TOOTH * reach)]
        if teeth:
            own = reach / abs(joint.position_factor(is_slide(model, name)))
            yield (
                f"column {tracks[0].column!r} jumps over its whole range at {teeth[0]:.6g} s, and "
                f"goes on as before ({len(teeth)} times in all); if its readings wrap around, give "
                f"joints.{name}.wrap, the size of a turn in them (they range over {own:.6g})"
            )


def _changes_pose(turn: float, model: mujoco.MjModel, joint: str) -> bool:
    """True unless a turn of the readings [rad or m] is one or more whole turns of a hinge."""
    turns = turn / TURN
    is_whole = round(turns) >= 1 and abs(turns / round(turns) - 1) < _ROUNDED
    return is_slide(model, joint) or not is_whole


def _teeth(track: Track, least: float) -> Iterator[float]:
    """Times of steps of at least `least` against the changes before and after, without a gap."""
    time, value = track.signal.time, track.signal.value
    for stretch in np.split(np.arange(len(time)), track.after_gaps):
        changes = stretch[np.diff(value[stretch], prepend=np.nan) != 0]
        steps = np.diff(value[changes])
        for step in np.flatnonzero(np.abs(steps) >= least).tolist():
            before, after = steps[max(step - _BESIDE, 0) : step], steps[step + 1 :][:_BESIDE]
            back = -np.sign(steps[step]) * np.concatenate([before, after])
            # an outlier has a step as large beside it
            if len(back) == 2 * _BESIDE and np.all((back > 0) & (back < least)):
                yield float(time[changes[step + 1]])


def _turns_of(given: LogMap, model: mujoco.MjModel) -> list[float | None]:
    """Sizes of the turns at which readings begin again, by joint, in the model's units."""
    maps = [(given.joints[name], is_slide(model, name)) for name in joints_of(model)]
    return [
        None if joint.wrap is None else abs(joint.position_factor(slide)) * joint.wrap
        for joint, slide in maps
    ]


def _going_on(track: Track, turn: float) -> Vector:
    """Positions without the jumps by a turn, within stretches and across gaps."""
    time, value = track.signal.time, np.unwrap(track.signal.value, period=turn)
    edges = [0, *track.after_gaps.tolist(), len(time)]
    for begin, gap, end in zip(edges, edges[1:], edges[2:], strict=False):
        before, after = slice(max(begin, gap - _SPEED), gap), slice(gap, min(end, gap + _SPEED))
        speeds = [
            np.polyfit(time[side] - time[gap], value[side], 1)[0]
            for side in (before, after)
            if side.stop - side.start > 1
        ]
        speed = np.mean(speeds) if speeds else 0.0
        due = value[gap - 1] + speed * (time[gap] - time[gap - 1])
        value[gap:] += turn * np.round((due - value[gap]) / turn)
    return value


def _middle_of_range(model: mujoco.MjModel, joint: str) -> float:
    return float(np.mean(model.joint(joint).range)) if model.joint(joint).limited[0] else 0.0


def _check_hinge(source: str, name: str, position: Track, joint: JointMap) -> None:
    """Raises InvalidInput for positions [rad] that jump by a turn."""
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


def _with(track: Track, value: Vector) -> Track:
    return replace(track, signal=replace(track.signal, value=value))

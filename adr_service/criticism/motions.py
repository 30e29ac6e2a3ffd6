"""Random motions of a robot: drawn as commands, simulated, and kept if they stay where they may.

    commands = drawn(limits, rows, rng)                     # (candidates, rows, nu)
    motions = from_starts(fit, commands, pose_of(fit, None))
    planned = followed(Simulator(nominal, motions), fit)    # the motions as the fit moves
    possible_motions(planned, measurement, allowed={}, episodes=12, model=model)

The recording to make next is chosen from these (`next_recording`).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.fits import Fit
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Simulator
from adr_service.errors import InvalidInput

_CANDIDATES = 96  # motions to choose from
_PACES = (0.5, 0.8, 0.9, 0.95, 0.98)  # share of a command that is left after a control step
_ALONE = 0.3  # of the motions move one actuator
_LEAST = 1e-6  # range of a position
_BEYOND = 0.5  # of a recorded range, that a plan may go further to both sides
_RESTING = 0.5  # of the usual speed, below which recorded episodes begin after a reset


def drawn(limits: Matrix, rows: int, rng: np.random.Generator) -> Array3:
    """(candidates, rows, nu) coloured noise, in all commands or in one."""
    low, high = limits.T
    commands = np.empty((_CANDIDATES, rows, len(limits)))
    for motion in commands:
        keep = rng.choice(_PACES)
        noise = rng.standard_normal((rows, len(limits)))
        motion[0] = noise[0]
        for row in range(1, rows):
            motion[row] = keep * motion[row - 1] + np.sqrt(1 - keep**2) * noise[row]
        if rng.uniform() < _ALONE:
            still = np.arange(len(limits)) != rng.integers(len(limits))
            motion[:, still] = 0.0
        motion[:] = np.clip((low + high) / 2 + motion * (high - low) / 2, low, high)
    return commands


def pose_of(fit: Fit, start: Mapping[int, float] | None) -> Vector | None:
    """(nq,) positions at rest to start from; None: recorded episodes begin at rest, so as they do.

    Episodes that are pieces of a longer recording begin in the middle of a motion, in which no
    robot can be put.
    """
    first, speed = np.split(_recorded_starts(fit), 2, axis=1)
    usual = np.sqrt(np.mean(np.split(fit.states, 2, axis=1)[1] ** 2, axis=0))
    if start is None and np.all(np.sqrt(np.mean(speed**2, axis=0)) <= _RESTING * usual):
        return None
    pose = first[0].copy()
    for joint, position in (start or {}).items():
        pose[joint] = position
    return pose


def from_starts(fit: Fit, commands: Array3, pose: Vector | None) -> Measurement:
    """Motions from a pose at rest, or from the states in which recorded episodes begin, in turn."""
    count, rows, width = commands.shape
    data, recorded = fit.simulator.data, _recorded_starts(fit)
    if pose is None:
        starts = recorded[np.arange(count) % len(recorded)]
    else:
        starts = np.tile(np.concatenate([pose, np.zeros_like(pose)]), (count, 1))
    qpos, qvel = np.split(np.repeat(starts, rows, axis=0), 2, axis=1)
    return Measurement(
        time=np.tile(data.period() * np.arange(rows), count),
        qpos=qpos,
        qvel=qvel,
        ctrl=commands.reshape(-1, width),
        episode=np.repeat(np.arange(count), rows),
        qpos_std=data.qpos_std,
        qvel_std=data.qvel_std,
    )


def _recorded_starts(fit: Fit) -> Matrix:
    """(episodes, 2 nv) states in which recorded episodes begin."""
    return fit.states[[first for first, _ in fit.simulator.data.spans()]]


def followed(simulator: Simulator, fit: Fit) -> Measurement:
    """The simulator's motions as a fit simulates them; one that diverges stays where it was."""
    data = simulator.data
    path = simulator.follow(fit.parameters, fit.effects)
    for first, last in data.spans():
        broken = np.flatnonzero(np.isnan(path[first:last]).any(axis=1))
        if broken.size:
            path[first + broken[0] : last] = path[first + broken[0] - 1]
    qpos, qvel = np.split(path, 2, axis=1)
    return replace(data, qpos=qpos, qvel=qvel)


def possible_motions(
    motions: Measurement,
    recorded: Measurement,
    allowed: Mapping[int, tuple[float, float]],
    episodes: int,
    model: mujoco.MjModel,
) -> list[int]:
    """Numbers of the simulated motions to choose from: at least `episodes`, near what was recorded.

    `allowed` has the smallest and largest position of joints by number. Raises InvalidInput if
    fewer stay finite and within.
    """
    finite = _that_stay_finite(motions)
    possible = _within(motions, finite, allowed)
    if len(possible) < episodes:
        alone = [
            f"{model.joint(joint).name} stays there in "
            f"{len(_within(motions, finite, {joint: bounds}))}"
            for joint, bounds in allowed.items()
        ]
        raise InvalidInput(
            f"of {_CANDIDATES} motions within these limits, {len(finite)} stay finite in "
            f"simulation, and {len(possible)} of them within the allowed positions"
            f"{' (' + ', '.join(alone) + ')' if alone else ''}; {episodes} are needed: give "
            "narrower limits of commands, allow more positions, or start elsewhere"
        )
    return _near(motions, recorded, possible, allowed, episodes)


def _that_stay_finite(motions: Measurement) -> list[int]:
    """Numbers of the motions that did not diverge: these never stand still to the last bit."""
    state = np.hstack([motions.qpos, motions.qvel])
    ends = enumerate(last for _, last in motions.spans())
    return [n for n, end in ends if not np.array_equal(state[end - 1], state[end - 2])]


def _within(
    motions: Measurement, possible: Sequence[int], allowed: Mapping[int, tuple[float, float]]
) -> list[int]:
    """Motions that never leave the positions which their joints are allowed."""
    spans = motions.spans()
    return [
        number
        for number in possible
        if all(
            np.all((low <= positions) & (positions <= high))
            for joint, (low, high) in allowed.items()
            for positions in [motions.qpos[slice(*spans[number]), joint]]
        )
    ]


def _near(
    motions: Measurement,
    recorded: Measurement,
    possible: Sequence[int],
    allowed: Collection[int],
    episodes: int,
) -> list[int]:
    """Motions that stay near the recorded positions, or those that leave them least.

    Joints with positions that are `allowed` do not count.
    """
    low, high = recorded.qpos.min(axis=0), recorded.qpos.max(axis=0)
    span = np.maximum(high - low, _LEAST)
    beyond = np.maximum(low - motions.qpos, motions.qpos - high) / span
    beyond[:, list(allowed)] = 0.0
    beyond, spans = beyond.max(axis=1), motions.spans()
    excess = {number: float(beyond[slice(*spans[number])].max()) for number in possible}
    near = [number for number in possible if excess[number] <= _BEYOND]
    return (
        near
        if len(near) >= episodes
        else sorted(sorted(possible, key=lambda n: excess[n])[:episodes])
    )


def reach_of(motions: Measurement) -> Matrix:
    return np.column_stack([motions.qpos.min(axis=0), motions.qpos.max(axis=0)])

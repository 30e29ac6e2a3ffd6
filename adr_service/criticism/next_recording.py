"""The recording to make next: commands on which explanations that are tied now would differ most.

    plan = next_recording(criticism, limits, rng)
    plan.commands                       # (episodes, rows, nu), each episode after the robot's reset
    plan.separations[0].if_named        # evidence to expect, in nats, if the named cause is true

Each of many random motions is simulated with one explanation, from the states in which recorded
episodes begin. By another explanation the same steps end elsewhere, also after its strengths and
the free parameters have changed to make up for it, in both recordings together. Half the sum of
squares of what is left, in units of one-step errors, is the evidence to expect if the first is
true. Motions are chosen one by one. Where nothing is tied, they are chosen to show as many effects
as possible, at sizes that sensible simulators lack.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.evidence import Fit, expected_errors
from adr_service.criticism.excitation import gained_by_effects
from adr_service.criticism.linearisation import by_parameters, by_strengths
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.pipeline import Criticism
from adr_service.criticism.scan import location_of
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.weighing import Weighed
from adr_service.effects.models import plausible_of
from adr_service.errors import InvalidInput
from adr_service.npz import read_arrays, write_arrays

_CANDIDATES = 96  # motions to choose from
_PACES = (0.5, 0.8, 0.9, 0.95, 0.98)  # share of a command that is left after a control step
_ALONE = 0.3  # of the motions move one actuator
_LEAST = 1e-6  # ridge, in squares of an error; range of a position
_BEYOND = 0.5  # of a recorded range, that a plan may go further to both sides
_PLANNED = ("time", "ctrl", "episode")
_Settings = tuple[int | None, int]  # threads, steps for one of the model's


@dataclass(frozen=True)
class Separation:
    """Evidence to expect from both recordings together, to first order."""

    named: str
    other: str
    if_named: float  # nats to expect if the named cause is true
    # the same if the other is true. If one can do all that the other does, only its own truth shows
    if_other: float

    @property
    def is_expected(self) -> bool:
        """True if one of the two can be told from the other."""
        return max(self.if_named, self.if_other) >= THRESHOLD


@dataclass(frozen=True)
class Plan:
    """Commands of the next recording, open loop."""

    commands: Array3  # (episodes, rows, nu)
    period: float  # [s] that each command holds
    separations: tuple[Separation, ...]
    reach: Matrix  # (nq, 2) smallest and largest positions in simulation, with what is named
    recorded: Matrix  # (nq, 2) the same of the recording that there is

    def to_npz(self) -> bytes:
        """An `.npz` of `time` (N,), `ctrl` (N, nu) and `episode` (N,), as in a measurement."""
        episodes, rows, width = self.commands.shape
        time = np.tile(self.period * np.arange(rows), episodes)
        number = np.repeat(np.arange(episodes), rows)
        ctrl = self.commands.reshape(-1, width)
        return write_arrays({"time": time, "ctrl": ctrl, "episode": number})


@dataclass(frozen=True)
class _Squares:
    """Least squares of one recording or motion: how far J x comes to r.

    r is the difference of two explanations in units of one-step errors, and J (k columns) its
    change by the strengths and parameters that could make up for it.
    """

    design: Matrix  # (k, k) J'J
    score: Vector  # (k,) J'r
    square: float  # r'r

    def __add__(self, other: "_Squares") -> "_Squares":
        return _Squares(
            self.design + other.design, self.score + other.score, self.square + other.square
        )

    def nats(self) -> float:
        """Half the sum of squares that refitting cannot absorb."""
        ridge = _LEAST * np.eye(len(self.score))
        absorbed = self.score @ np.linalg.solve(self.design + ridge, self.score)
        return max(float(self.square - absorbed), 0.0) / 2


@dataclass(frozen=True)
class _Comparison:
    """The part of a true explanation that another cannot make up for."""

    recorded: _Squares
    motions: list[_Squares]

    def nats(self, chosen: Sequence[int]) -> float:
        """Evidence to expect from the recorded data and the chosen motions."""
        total = self.recorded
        for number in chosen:
            total = total + self.motions[number]
        return total.nats()


def next_recording(
    criticism: Criticism,
    limits: Matrix,
    rng: np.random.Generator,
    *,
    allowed: Mapping[int, tuple[float, float]] | None = None,
    episodes: int = 12,
    seconds: float = 1.5,
    threads: int | None = None,
) -> Plan:
    """The best of many motions within limits (nu, 2) of each command.

    `allowed` has the smallest and largest position [rad or m] of joints by number, which no motion
    leaves in simulation. Other joints stay near the recorded positions if that is possible. Raises
    InvalidInput for limits that `check_limits` refuses, and if too few motions within all these
    stay finite in simulation.
    """
    final, recorded = criticism.final, criticism.final.simulator.data
    check_limits(limits, final.simulator)
    rows = max(round(seconds / recorded.period()), 2)
    commands = _motions(limits, rows, rng)
    motions = _from_recorded_starts(final, commands)
    pairs = [(alike[0], other) for alike in criticism.named for other in alike[1:]]
    nominal, settings = final.simulator.nominal, (threads, final.simulator.finer)
    with (
        Simulator(nominal, recorded, *settings) as before,
        Simulator(nominal, motions, *settings) as free,
    ):
        planned = _followed(free, final)
        compared: list[tuple[_Comparison, _Comparison]] = []
        for one, other in pairs:
            if_one = _compare(one.fit, other.fit, before, free, settings)
            if_other = _compare(other.fit, one.fit, before, free, settings)
            compared.append((if_one, if_other))
    finite = _that_stay_finite(planned)
    possible = _within(planned, finite, allowed or {})
    if len(possible) < episodes:
        raise InvalidInput(
            f"of {_CANDIDATES} motions within these limits, {len(finite)} stay finite in "
            f"simulation, and {len(possible)} of them within the allowed positions; {episodes} are "
            "needed (give narrower limits of commands, or allow more positions)"
        )
    possible = _near(planned, recorded, possible, allowed or {}, episodes)
    if compared:
        chosen = _best(compared, possible, episodes)
    else:
        with Simulator(nominal, planned, *settings) as simulator:
            chosen = _most_shown(final, simulator, possible, episodes)
    return Plan(
        commands[chosen],
        recorded.period(),
        tuple(
            Separation(_name(one), _name(other), if_one.nats(chosen), if_other.nats(chosen))
            for (one, other), (if_one, if_other) in zip(pairs, compared, strict=True)
        ),
        _reach(planned.episodes(sorted(chosen))),
        _reach(recorded),
    )


def check_limits(limits: Matrix, simulator: Simulator) -> None:
    """Raises InvalidInput unless each command has limits that its actuator obeys."""
    count = simulator.data.ctrl.shape[1]
    is_good = limits.shape == (count, 2) and bool(np.all(np.isfinite(limits)))
    if not is_good or not np.all(limits[:, 0] <= limits[:, 1]):
        raise InvalidInput(
            f"limits of commands must be {count} pairs of numbers, the lower first; given "
            f"{limits.tolist()}"
        )
    for number, (low, high) in enumerate(limits.tolist()):
        actuator = simulator.base.actuator(number)
        least, most = actuator.ctrlrange
        if actuator.ctrllimited[0] and (low < least or high > most):
            raise InvalidInput(
                f"{actuator.name} obeys commands from {least:g} to {most:g}; given are limits of "
                f"{low:g} to {high:g}"
            )


def recorded_limits(simulator: Simulator) -> Matrix:
    """(nu, 2) smallest and largest command of a recording that the actuators obeyed."""
    obeyed = simulator.commands((), simulator.steps)
    return np.column_stack([obeyed.min(axis=(0, 1)), obeyed.max(axis=(0, 1))])


def read_commands(content: bytes, width: int, period: float) -> list[Matrix]:
    """The commands (rows, nu) of each episode of a plan's `.npz`.

    Raises InvalidInput unless each holds for `period` seconds and they are for `width` actuators.
    """
    arrays = read_arrays(content, _PLANNED)
    if missing := [name for name in _PLANNED if name not in arrays]:
        raise InvalidInput(f"the plan lacks {missing}; `adr criticise --next` writes one")
    time, ctrl, episode = (arrays[name] for name in _PLANNED)
    if ctrl.dtype.kind not in "iuf" or ctrl.ndim != 2 or ctrl.shape[1] != width:
        raise InvalidInput(
            f"the plan's commands are {ctrl.dtype} of shape {ctrl.shape}; expected are numbers of "
            f"shape (rows, {width})"
        )
    # a plan is a measurement of a robot without joints
    empty = np.empty((len(ctrl), 0))
    plan = Measurement(time=time, qpos=empty, qvel=empty, ctrl=ctrl, episode=episode)
    if abs(plan.period() - period) > 1e-3 * period:
        raise InvalidInput(
            f"the plan's commands hold for {plan.period():g} s; the robot's hold for {period:g} s"
        )
    return [plan.ctrl[first:last] for first, last in plan.spans()]


def _motions(limits: Matrix, rows: int, rng: np.random.Generator) -> Array3:
    """(candidates, rows, nu) coloured noise, in all commands or in one."""
    low, high = limits.T
    commands = np.empty((_CANDIDATES, rows, len(limits)))
    for motion in commands:
        keep = rng.choice(_PACES)
        noise = rng.standard_normal((rows, len(limits)))
        state = noise[0]
        for row in range(rows):
            state = keep * state + np.sqrt(1 - keep**2) * noise[row]
            motion[row] = state
        if rng.uniform() < _ALONE:
            still = np.arange(len(limits)) != rng.integers(len(limits))
            motion[:, still] = 0.0
        motion[:] = np.clip((low + high) / 2 + motion * (high - low) / 2, low, high)
    return commands


def _from_recorded_starts(fit: Fit, commands: Array3) -> Measurement:
    """Motions from the states in which recorded episodes begin, in turn."""
    count, rows, width = commands.shape
    data = fit.simulator.data
    firsts = np.array([first for first, _ in data.spans()])
    states = np.repeat(fit.states[firsts[np.arange(count) % len(firsts)]], rows, axis=0)
    qpos, qvel = np.split(states, 2, axis=1)
    return Measurement(
        time=np.tile(data.period() * np.arange(rows), count),
        qpos=qpos,
        qvel=qvel,
        ctrl=commands.reshape(-1, width),
        episode=np.repeat(np.arange(count), rows),
    )


def _followed(simulator: Simulator, fit: Fit) -> Measurement:
    """The simulator's motions as a fit simulates them; one that diverges stays where it was."""
    data = simulator.data
    path = simulator.follow(fit.parameters, fit.effects)
    for first, last in data.spans():
        broken = np.flatnonzero(np.isnan(path[first:last]).any(axis=1))
        if broken.size:
            path[first + broken[0] : last] = path[first + broken[0] - 1]
    qpos, qvel = np.split(path, 2, axis=1)
    return replace(data, qpos=qpos, qvel=qvel)


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


def _compare(
    true: Fit, other: Fit, before: Simulator, free: Simulator, settings: _Settings
) -> _Comparison:
    """Compare two explanations in the recorded data and in each motion, if `true` is true."""
    (recorded,) = _squares(true, other, before, true.states, [(0, len(before.starts))])
    with Simulator(free.nominal, _followed(free, true), *settings) as after:
        motions = _squares(true, other, after, after.measured, after.transitions())
    return _Comparison(recorded, motions)


def _squares(
    true: Fit, other: Fit, simulator: Simulator, states: Matrix, parts: Sequence[tuple[int, int]]
) -> list[_Squares]:
    """The sums over these ranges of transitions."""
    unit = expected_errors(true)
    measured, base = np.isfinite(unit), simulator.base
    known = (other.parameters, other.effects, states)
    truth = simulator.predict_quickly(true.parameters, true.effects, states)
    rest = (truth - simulator.predict_quickly(*known)) / unit
    columns = [*by_parameters(simulator, *known), *by_strengths(simulator, *known, other.effects)]
    space = simulator.nominal.space
    # the most that each can make up for, so that the ridge is small beside it
    most = [space.high - space.low, *(plausible_of(base, effect) for effect in other.effects)]
    design = np.stack(columns, axis=2) / unit[:, None] * np.concatenate(most)
    rest, design = np.nan_to_num(rest[:, measured]), np.nan_to_num(design[:, measured])
    return [_summed(design[first:last], rest[first:last]) for first, last in parts]


def _summed(design: Array3, rest: Matrix) -> _Squares:
    flat, short = design.reshape(-1, design.shape[2]), rest.ravel()
    return _Squares(flat.T @ flat, flat.T @ short, float(short @ short))


def _best(
    compared: Sequence[tuple[_Comparison, _Comparison]], possible: Sequence[int], episodes: int
) -> list[int]:
    """Motions, one by one, that separate all pairs best.

    The worth of evidence is its logarithm, so that a pair which is separated already counts less
    than one which is not, and one that nothing separates not at all.
    """
    chosen: list[int] = []
    for _ in range(episodes):
        left = [number for number in possible if number not in chosen]
        worth = [
            sum(np.log1p(each.nats([*chosen, n]) / THRESHOLD) for pair in compared for each in pair)
            for n in left
        ]
        chosen.append(left[int(np.argmax(worth))])
    return chosen


def _most_shown(
    final: Fit, simulator: Simulator, possible: Sequence[int], episodes: int
) -> list[int]:
    """Motions, one by one, that bring most effects near the threshold of evidence."""
    noise = np.where(final.simulator.data.is_measured(), np.sqrt(final.noise.sensor), np.nan)
    gains = gained_by_effects(simulator, noise, simulator.measured)
    nats = np.nan_to_num(np.stack([gained for _, gained in gains]))  # (effects, N)
    each = np.stack([nats[:, a:b].sum(axis=1) for a, b in simulator.transitions()])
    chosen: list[int] = []
    total = np.zeros(each.shape[1])
    for _ in range(episodes):
        left = [number for number in possible if number not in chosen]
        worth = np.minimum(total + each[left], THRESHOLD).sum(axis=1)
        chosen.append(left[int(np.argmax(worth))])
        total = total + each[chosen[-1]]
    return chosen


def _name(weighed: Weighed) -> str:
    return f"{weighed.effects[0].kind} {location_of(weighed.effects)}"


def _reach(motions: Measurement) -> Matrix:
    return np.column_stack([motions.qpos.min(axis=0), motions.qpos.max(axis=0)])

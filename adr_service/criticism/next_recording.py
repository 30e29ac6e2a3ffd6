"""The recording to make next: commands on which explanations that are tied now would differ most.

    plan = next_recording(criticism, limits, rng)
    plan.commands                       # (episodes, rows, nu), each episode after the robot's reset
    plan.separations[0].expected        # nats between the named cause and the one tied with it

Each of many random motions is simulated with one explanation, from the states in which recorded
episodes begin. By another explanation the same steps end elsewhere, also after its strengths and
the free parameters have changed to make up for it, in both recordings together. Half the sum of
squares of what is left, in units of one-step errors, is the evidence to expect if the first is
true. Motions are chosen one by one. Where nothing is tied, they are chosen to show as many effects
as possible, at sizes that sensible simulators lack.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.evidence import Fit, expected_errors
from adr_service.criticism.excitation import gained_by_effects
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.pipeline import Criticism
from adr_service.criticism.scan import location_of
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.weighing import Weighed
from adr_service.effects.base import Effect
from adr_service.errors import InvalidInput
from adr_service.npz import write_arrays

_CANDIDATES = 96  # motions to choose from
_PACES = (0.5, 0.8, 0.9, 0.95, 0.98)  # share of a command that is left after a control step
_ALONE = 0.3  # of the motions move one actuator
_STEP, _LEAST = 1e-2, 1e-6  # of a strength or parameter, for derivatives; ridge, of one error


@dataclass(frozen=True)
class Separation:
    """How well both recordings together separate two explanations, to first order."""

    named: str
    other: str
    if_named: float  # nats to expect if the named cause is true
    # nats to expect if the other is. Where one explains all that the other can do, and more, it is
    # told from the other only if it is true
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

    def to_npz(self) -> bytes:
        """An `.npz` of `time` (N,), `ctrl` (N, nu) and `episode` (N,), as in a measurement."""
        episodes, rows, width = self.commands.shape
        time = np.tile(self.period * np.arange(rows), episodes)
        number = np.repeat(np.arange(episodes), rows)
        ctrl = self.commands.reshape(-1, width)
        return write_arrays({"time": time, "ctrl": ctrl, "episode": number})


@dataclass(frozen=True)
class _Squares:
    """Sums of squares of one recording or motion, as `_Pair` compares it.

    r = what two explanations differ by, J = its change by what could make up for it (k columns).
    """

    design: Matrix  # (k, k) J'J
    score: Vector  # (k,) J'r
    square: float  # r'r

    def __add__(self, other: "_Squares") -> "_Squares":
        return _Squares(
            self.design + other.design, self.score + other.score, self.square + other.square
        )

    def nats(self) -> float:
        """What is left of the difference, as half a sum of squares."""
        ridge = _LEAST * np.eye(len(self.score))
        absorbed = self.score @ np.linalg.solve(self.design + ridge, self.score)
        return max(float(self.square - absorbed), 0.0) / 2


@dataclass(frozen=True)
class _Comparison:
    """What one explanation leaves of another that is true, in the recorded data and each motion."""

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
    episodes: int = 12,
    seconds: float = 1.5,
    threads: int | None = None,
) -> Plan:
    """The best of many motions within limits (nu, 2) of each command.

    Raises InvalidInput for limits of another shape.
    """
    final = criticism.final
    recorded = final.simulator.data
    check_limits(limits, recorded)
    rows = max(round(seconds / recorded.period()), 2)
    commands = _motions(limits, rows, rng)
    motions = _from_recorded_starts(recorded, commands)
    pairs = [(alike[0], other) for alike in criticism.named for other in alike[1:]]
    nominal, finer = final.simulator.nominal, final.simulator.finer
    with (
        Simulator(nominal, recorded, threads, finer) as before,
        Simulator(nominal, motions, threads, finer) as after,
    ):
        paths = after.follow(final.parameters, final.effects)
        compared = [
            (_compare(a.fit, b.fit, before, after), _compare(b.fit, a.fit, before, after))
            for a, b in pairs
        ]
        chosen = (
            _best(compared, episodes) if compared else _most_shown(final, after, paths, episodes)
        )
    return Plan(
        commands[chosen],
        recorded.period(),
        tuple(
            Separation(_name(a), _name(b), if_a.nats(chosen), if_b.nats(chosen))
            for (a, b), (if_a, if_b) in zip(pairs, compared, strict=True)
        ),
        _reach(paths, motions, chosen),
    )


def check_limits(limits: Matrix, data: Measurement) -> None:
    """Raises InvalidInput unless there is a lower and a higher limit for each command."""
    count = data.ctrl.shape[1]
    if limits.shape != (count, 2) or not np.all(limits[:, 0] < limits[:, 1]):
        raise InvalidInput(
            f"limits of commands must be {count} pairs, the lower first; given {limits.tolist()}"
        )


def recorded_limits(data: Measurement) -> Matrix:
    """(nu, 2) smallest and largest command of a recording."""
    return np.column_stack([data.ctrl.min(axis=0), data.ctrl.max(axis=0)])


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


def _from_recorded_starts(data: Measurement, commands: Array3) -> Measurement:
    """Motions from the states in which recorded episodes begin, in turn."""
    count, rows, width = commands.shape
    firsts = np.array([first for first, _ in data.spans()])
    starts = np.repeat(firsts[np.arange(count) % len(firsts)], rows)
    return Measurement(
        time=np.tile(data.period() * np.arange(rows), count),
        qpos=data.qpos[starts],
        qvel=data.qvel[starts],
        ctrl=commands.reshape(-1, width),
        episode=np.repeat(np.arange(count), rows),
    )


def _compare(true: Fit, other: Fit, before: Simulator, after: Simulator) -> _Comparison:
    paths = after.follow(true.parameters, true.effects)
    everything, motions = [slice(None)], _parts(after)
    (recorded,) = _squares(true, other, before, true.states, everything)
    return _Comparison(recorded, _squares(true, other, after, paths, motions))


def _squares(
    true: Fit, other: Fit, simulator: Simulator, states: Matrix, parts: Sequence[slice]
) -> list[_Squares]:
    """The sums over these parts of all transitions."""
    unit = expected_errors(true)
    measured = np.isfinite(unit)

    def predicted(parameters: Vector, strengths: Vector) -> Matrix:
        effects = _with(other, strengths)
        ends = simulator.predict_quickly(parameters, effects, states)
        return (ends / unit)[:, measured]

    known, strengths = other.parameters, _strengths(other)
    ends = predicted(known, strengths)
    truth = simulator.predict_quickly(true.parameters, true.effects, states)
    rest = np.nan_to_num((truth / unit)[:, measured] - ends)
    columns: list[Matrix] = []
    for number, value in enumerate(known):
        moved = known.copy()
        moved[number] += _STEP * value or _STEP
        columns.append((predicted(moved, strengths) - ends) / (moved[number] - value))
    for number, value in enumerate(strengths):
        moved = strengths.copy()
        moved[number] += _STEP * value or _STEP
        columns.append((predicted(known, moved) - ends) / (moved[number] - value))
    # in units of what each column can do at most, for the ridge's sake
    design = np.nan_to_num(np.stack(columns, axis=2))
    design = design * np.append(np.abs(known), np.abs(strengths))
    return [_summed(design[part], rest[part]) for part in parts]


def _summed(design: Array3, rest: Matrix) -> _Squares:
    flat, short = design.reshape(-1, design.shape[2]), rest.ravel()
    return _Squares(flat.T @ flat, flat.T @ short, float(short @ short))


def _parts(simulator: Simulator) -> list[slice]:
    """Transitions of each episode."""
    lengths = [last - first - 1 for first, last in simulator.data.spans()]
    ends = np.cumsum(lengths).tolist()
    return [slice(end - length, end) for end, length in zip(ends, lengths, strict=True)]


def _best(compared: Sequence[tuple[_Comparison, _Comparison]], episodes: int) -> list[int]:
    """Motions, one by one, that separate all pairs best.

    The worth of evidence is its logarithm, so that a pair which is separated already counts less
    than one which is not, and one that nothing separates not at all.
    """
    chosen: list[int] = []
    for _ in range(episodes):
        left = [number for number in range(_CANDIDATES) if number not in chosen]
        worth = [
            sum(np.log1p(each.nats([*chosen, n]) / THRESHOLD) for pair in compared for each in pair)
            for n in left
        ]
        chosen.append(left[int(np.argmax(worth))])
    return chosen


def _most_shown(final: Fit, simulator: Simulator, paths: Matrix, episodes: int) -> list[int]:
    """Motions, one by one, that bring most effects near the threshold of evidence."""
    noise = np.where(final.simulator.data.is_measured(), np.sqrt(final.noise.sensor), np.nan)
    nats = np.stack([gained for _, gained in gained_by_effects(simulator, noise, paths)])
    each = np.stack([np.nansum(nats[:, part], axis=1) for part in _parts(simulator)])
    chosen: list[int] = []
    total = np.zeros(each.shape[1])
    for _ in range(episodes):
        worth = np.minimum(total + each, THRESHOLD).sum(axis=1)
        worth[chosen] = -np.inf
        chosen.append(int(np.argmax(worth)))
        total = total + each[chosen[-1]]
    return chosen


def _strengths(fit: Fit) -> Vector:
    return np.array([value for effect in fit.effects for value in effect.values])


def _with(fit: Fit, strengths: Vector) -> list[Effect]:
    """The fit's effects with other strengths."""
    left = iter(strengths.tolist())
    return [replace(each, values=tuple(next(left) for _ in each.values)) for each in fit.effects]


def _name(weighed: Weighed) -> str:
    return f"{weighed.effects[0].kind} {location_of(weighed.effects)}"


def _reach(paths: Matrix, motions: Measurement, chosen: Sequence[int]) -> Matrix:
    spans = motions.spans()
    rows = np.concatenate([np.arange(*spans[number]) for number in chosen])
    positions = paths[rows, : motions.qpos.shape[1]]
    return np.column_stack([np.nanmin(positions, axis=0), np.nanmax(positions, axis=0)])

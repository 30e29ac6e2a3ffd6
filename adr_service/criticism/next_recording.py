"""The recording to make next: commands on which explanations that are tied now would differ most.

    plan = next_recording(criticism, limits, rng)
    plan.commands                       # (episodes, rows, nu)
    plan.start                          # (nq,) pose at rest from which each episode starts
    plan.separations[0].if_named        # evidence to expect, in nats, if the named cause is true

Each of many random motions is simulated with one explanation. It begins in a pose at rest, or in
the states in which recorded episodes begin, if these are at rest: then a reset made them. By
another explanation the same steps end elsewhere, also after its strengths and the free parameters
have changed to make up for it, in both recordings together. Half the sum of squares of what is
left, in units of one-step errors, is the evidence to expect if the first is true. Motions are
chosen one by one. Where nothing is tied, they are chosen to show as many effects as possible, at
sizes that sensible simulators lack.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.compatibility import commanded_actuators
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.evidence import expected_errors
from adr_service.criticism.excitation import gained_by_effects
from adr_service.criticism.fits import Fit
from adr_service.criticism.linearisation import by_parameters, by_strengths
from adr_service.criticism.motions import (
    drawn,
    followed,
    from_starts,
    pose_of,
    possible_motions,
    reach_of,
)
from adr_service.criticism.pipeline import Criticism
from adr_service.criticism.plans import Plan, Separation
from adr_service.criticism.scan import location_of
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.weighing import Weighed
from adr_service.effects.actuators import obeys_limits
from adr_service.effects.models import plausible_of
from adr_service.errors import InvalidInput

_LEAST = 1e-6  # ridge, in squares of an error
_Settings = tuple[int | None, int]  # threads, steps for one of the model's


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
    start: Mapping[int, float] | None = None,
    episodes: int = 12,
    seconds: float = 1.5,
    threads: int | None = None,
) -> Plan:
    """The best of many motions within limits (nu, 2) of each command.

    `allowed` has the smallest and largest position [rad or m] of joints by number, which no motion
    leaves in simulation. Other joints stay near the recorded positions if that is possible. `start`
    has positions of joints by number in which each episode starts at rest, with the others where
    the recording begins; None: so does every joint, unless recorded episodes begin at rest. Raises
    InvalidInput for limits that `check_limits` refuses, and if too few motions within all these
    stay finite in simulation.
    """
    final, recorded = criticism.final, criticism.final.simulator.data
    check_limits(limits, final.simulator.base)
    rows = max(round(seconds / recorded.period()), 2)
    commands = drawn(limits, rows, rng)
    pose = pose_of(final, start)
    motions = from_starts(final, commands, pose)
    pairs = [(alike[0], other) for alike in criticism.named for other in alike[1:]]
    nominal, settings = final.simulator.nominal, (threads, final.simulator.finer)
    with (
        Simulator(nominal, recorded, *settings) as before,
        Simulator(nominal, motions, *settings) as free,
    ):
        planned = followed(free, final)
        base = final.simulator.base
        possible = possible_motions(planned, recorded, allowed or {}, episodes, base)
        compared: list[tuple[_Comparison, _Comparison]] = []
        for one, other in pairs:
            if_one = _compare(one.fit, other.fit, before, free, settings)
            if_other = _compare(other.fit, one.fit, before, free, settings)
            compared.append((if_one, if_other))
    newly_shown: tuple[str, ...] = ()
    if compared:
        chosen = _best(compared, possible, episodes)
    else:
        with (
            Simulator(nominal, recorded, *settings) as before,
            Simulator(nominal, planned, *settings) as after,
        ):
            chosen, newly_shown = _most_shown(final, before, after, possible, episodes)
    return Plan(
        commands[chosen],
        recorded.period(),
        tuple(
            Separation(_name(one), _name(other), if_one.nats(chosen), if_other.nats(chosen))
            for (one, other), (if_one, if_other) in zip(pairs, compared, strict=True)
        ),
        newly_shown,
        pose,
        reach_of(planned.episodes(sorted(chosen))),
        reach_of(recorded),
    )


def check_limits(limits: Matrix, model: mujoco.MjModel) -> None:
    """Raises InvalidInput unless there are commands, with limits that their actuators obey."""
    count = len(commanded_actuators(model))
    if not count:
        raise InvalidInput("the model has no actuators, so that a plan has nothing to command")
    is_good = limits.shape == (count, 2) and bool(np.all(np.isfinite(limits)))
    if not is_good or not np.all(limits[:, 0] <= limits[:, 1]):
        raise InvalidInput(
            f"limits of commands must be {count} pairs of numbers, the lower first; given "
            f"{limits.tolist()}"
        )
    is_limited = obeys_limits(model)
    for number, (low, high) in enumerate(limits.tolist()):
        actuator = model.actuator(number)
        least, most = actuator.ctrlrange
        if is_limited[number] and (low < least or high > most):
            raise InvalidInput(
                f"{actuator.name} obeys commands from {least:g} to {most:g}; given are limits of "
                f"{low:g} to {high:g}"
            )


def recorded_limits(simulator: Simulator) -> Matrix:
    """(nu, 2) smallest and largest command of a recording that the actuators obeyed."""
    obeyed = simulator.commands((), simulator.steps)
    return np.column_stack([obeyed.min(axis=(0, 1)), obeyed.max(axis=(0, 1))])


def _compare(
    true: Fit, other: Fit, before: Simulator, free: Simulator, settings: _Settings
) -> _Comparison:
    """Compare two explanations in the recorded data and in each motion, if `true` is true."""
    (recorded,) = _squares(true, other, before, true.states, [(0, len(before.starts))])
    with Simulator(free.nominal, followed(free, true), *settings) as after:
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
    quickly = simulator.predict_quickly(*known)
    rest = (truth - quickly) / unit
    columns = [
        *by_parameters(simulator, *known, quickly),
        *by_strengths(simulator, *known, other.effects, quickly),
    ]
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
    final: Fit, before: Simulator, after: Simulator, possible: Sequence[int], episodes: int
) -> tuple[list[int], tuple[str, ...]]:
    """Motions, one by one, that bring most effects near the threshold of evidence, and the effects
    that are beyond it with them and not without."""
    noise = np.where(final.simulator.data.is_measured(), np.sqrt(final.noise.sensor), np.nan)
    gains = list(gained_by_effects(after, noise, after.measured))
    nats = np.nan_to_num(np.stack([gained for _, gained in gains]))  # (effects, N)
    names = [f"{effect.kind} {effect.location}" for effect, _ in gains]
    recorded = {
        f"{effect.kind} {effect.location}": float(np.nansum(gained))
        for effect, gained in gained_by_effects(before, noise, before.measured)
    }
    known = np.array([recorded.get(name, 0.0) for name in names])
    each = np.stack([nats[:, a:b].sum(axis=1) for a, b in after.transitions()])
    chosen: list[int] = []
    total = known.copy()
    for _ in range(episodes):
        left = [number for number in possible if number not in chosen]
        worth = np.minimum(total + each[left], THRESHOLD).sum(axis=1)
        chosen.append(left[int(np.argmax(worth))])
        total = total + each[chosen[-1]]
    is_new = (known < THRESHOLD) & (total >= THRESHOLD)
    return chosen, tuple(name for name, new in zip(names, is_new, strict=True) if new)


def _name(weighed: Weighed) -> str:
    return f"{weighed.effects[0].kind} {location_of(weighed.effects)}"

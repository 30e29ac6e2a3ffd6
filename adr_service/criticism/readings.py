"""Readings of a measured robot's sensors, by its motion.

States are positions, then velocities. Some effects in sensors depend on rates of change, which are
simulated, and some on the way that a position has come before.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.past import WITHIN, displacements, within
from adr_service.effects.base import Effect, Past
from adr_service.effects.signals import rates_at_ends, shown, windows


@dataclass(frozen=True)
class Paths:
    """The robot's own motion from each row to the next, whatever its sensors show of it."""

    true_states: Matrix  # (rows, 2 nv) at all rows
    states: Array3  # (N, steps + 1, 2 nv) from the rows with a next one on
    timestep: float  # [s]


class Sensors:
    """The sensors of one measured robot."""

    def __init__(self, base: mujoco.MjModel, data: Measurement, ends: Callable[[], Matrix]):
        """`ends`: measured states (N, 2 nv) one control step on, by the nominal model."""
        self._base, self._data, self._ends = base, data, ends
        self._period = data.period()
        self._starts = np.flatnonzero(np.diff(data.episode) == 0)  # (N,) of transitions
        self._measured = np.concatenate([data.qpos, data.qvel], axis=1)
        self._past: dict[int, Matrix] = {}  # by position

    def shown(self, effects: Sequence[Effect], paths: Paths) -> tuple[Matrix, Matrix]:
        """Readings (rows, 2 nv) at all rows, and (N, 2 nv) one control step after those with a
        next one, by sensors with these effects."""
        rates = self.rates(effects, paths)
        now = shown(self._base, effects, paths.true_states, rates, self.past)
        return now, self.after(effects, paths)

    def after(self, effects: Sequence[Effect], paths: Paths) -> Matrix:
        """Readings (N, 2 nv) at the ends of paths."""
        before, after = paths.states[:, 0], paths.states[:, -1]
        rates = rates_at_ends(paths.states, paths.timestep, windows(self._base, effects))
        return shown(self._base, effects, after, rates, self.past_after(before, after))

    def rates(self, effects: Sequence[Effect], paths: Paths) -> Matrix:
        """(rows, 2 nv) rate of change just before each row; at an episode's first row, just after
        it. Over what the effects need of it, else over a step."""
        known = (paths.timestep, windows(self._base, effects))
        rates = np.zeros_like(paths.true_states)
        rates[self._starts + 1] = rates_at_ends(paths.states, *known)
        is_first = np.r_[True, np.diff(self._data.episode[self._starts]) != 0]
        rates[self._starts[is_first]] = -rates_at_ends(paths.states[is_first, ::-1], *known)
        return np.nan_to_num(rates)  # a step that diverges must not end the next one as well

    def past(self, column: int) -> Matrix:
        """(rows, k) how far a position has come since each of the moments before, the latest first,
        back to its episode's first.

        By its measured velocities or by the nominal model, whichever is nearer to the readings; by
        these alone where no velocity was measured.
        """
        if column not in self._past:
            before, after = self._measured[self._starts], self._measured[self._starts + 1]
            velocity, read = self._base.nq + column, (after - before)[:, column]
            moved = read
            if self._data.is_measured()[velocity]:
                by_velocities = (before[:, velocity] + after[:, velocity]) / 2 * self._period
                simulated = (self._ends() - before)[:, column]
                moved = min((by_velocities, simulated), key=lambda each: np.abs(each - read).sum())
            come = np.zeros((len(self._measured) - 1, WITHIN))
            come[self._starts] = self._within(column, moved, before, after)
            first = np.concatenate([np.full(b - a, a) for a, b in self._data.spans()])
            self._past[column] = displacements(come, first)
        return self._past[column]

    def past_after(self, before: Matrix, after: Matrix) -> Past:
        """`past` at the ends of all transitions, from states `before` to `after` (N, 2 nv) them."""

        def past(column: int) -> Matrix:
            moved = (after - before)[:, column]
            come = self._within(column, moved, before, after)
            latest = np.column_stack([np.zeros(len(come)), come[:, :-1]])[:, ::-1]
            earlier = self.past(column)[self._starts, :-WITHIN]
            return moved[:, None] - np.column_stack([latest, -earlier])

        return past

    def _within(self, column: int, moved: Vector, before: Matrix, after: Matrix) -> Matrix:
        """Distances (n, WITHIN) that a position covers within steps that move it by `moved`."""
        velocity = self._base.nq + column
        if not self._data.is_measured()[velocity]:
            return within(moved, None, None)
        return within(moved, before[:, velocity] * self._period, after[:, velocity] * self._period)

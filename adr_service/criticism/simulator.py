"""Predictions of a nominal simulator, one control step ahead of every measured state.

    simulator = Simulator(nominal, measurement)
    predicted = simulator.predict(parameters, effects, states)      # (N, 2 nv)

States are in the sensors' coordinates, positions then velocities. An effect in a sensor is undone
before the simulation and applied again after it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import mujoco
import numpy as np

from adr_service.arrays import Array3, Indices, Matrix, Vector
from adr_service.criticism.compatibility import check_columns, steps_between
from adr_service.criticism.engine import Engine, quiet
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.past import past_along
from adr_service.criticism.readings import Paths, Sensors
from adr_service.effects.actuators import obeys_limits
from adr_service.effects.base import Effect, is_added
from adr_service.effects.models import elements_of
from adr_service.effects.signals import (
    acts_on_commands,
    behind,
    obeyed,
    rates_at_ends,
    shown,
    windows,
)

FINER = 3  # how much smaller a step shows what numerical integration adds
_KEPT, _KEPT_COMMANDS = 32, 4  # compiled models, and commands after effects, which may be large
_MISSED = 0.1  # most of a force's response that coarser steps may miss


@dataclass(frozen=True)
class _Added:
    """A constant that a prediction adds to all commands of one actuator, or to the force on one
    degree of freedom."""

    actuator: int = 0
    command: float = 0.0
    dof: int = 0
    force: float = 0.0  # generalised [N or N m]


class Simulator:
    """Predicts all transitions of one measurement, under any parameters and effects."""

    def __init__(
        self, nominal: Nominal, data: Measurement, threads: int | None = None, finer: int = 1
    ):
        """`finer`: number of steps that it takes for one of the model's."""
        self.nominal, self.data, self.finer = nominal, data, finer
        self._asked_threads = threads
        self.base = nominal.model(nominal.start)
        self._bare = lru_cache(_KEPT)(nominal.bare)  # most predictions share them
        check_columns(self.base, data)
        self.period = data.period()
        self.steps = finer * steps_between(self.period, self.base.opt.timestep)
        self.starts: Indices = np.flatnonzero(np.diff(data.episode) == 0)  # (N,) of transitions
        self.measured = np.concatenate([data.qpos, data.qvel], axis=1)  # (rows, 2 nv)
        self._engine = Engine(self.base, threads)
        self.simulated_steps = 0  # control steps, of all predictions
        self._commands = lru_cache(_KEPT_COMMANDS)(self._commands_after)

    def __enter__(self) -> "Simulator":
        return self

    def __exit__(self, *_: object) -> None:
        """End its threads; it predicts nothing more."""
        self._engine.close()
        self._commands.cache_clear()
        if "in_finer_steps" in vars(self):
            self.in_finer_steps.__exit__()

    @cached_property
    def in_finer_steps(self) -> "Simulator":
        """The same with steps that are `FINER` times smaller; it ends with this one."""
        return Simulator(self.nominal, self.data, self._asked_threads, FINER * self.finer)

    def predict(self, values: Vector, effects: Sequence[Effect], states: Matrix) -> Matrix:
        """Measured states (N, 2 nv) one control step after `states` (rows, 2 nv).

        NaN where the simulation diverged.
        """
        return self._predict(effects, states, self.model(values, effects))

    def true_states(self, values: Vector, effects: Sequence[Effect], states: Matrix) -> Matrix:
        """The robot's states (rows, 2 nv) behind what its sensors show."""
        return self._true(effects, states, self.model(values, effects))

    def paths(self, values: Vector, effects: Sequence[Effect], true: Matrix) -> Paths:
        """The motion one control step on from the robot's states (rows, 2 nv)."""
        return self._paths(effects, true, self.model(values, effects))

    def follow(self, values: Vector, effects: Sequence[Effect]) -> Matrix:
        """Measured states (rows, 2 nv), whole episodes simulated from their first rows on.

        NaN where the simulation diverged.
        """
        model = self.model(values, effects)
        commands = self.commands(effects, self.steps)
        true = self._true(effects, self.measured, model)
        followed, spans = self.measured.copy(), self.data.spans()
        longest = max(last - first for first, last in spans) - 1
        control = np.zeros((len(spans), longest * self.steps, model.nu + model.nv))
        for given, (begin, end) in zip(control, self.transitions(), strict=True):
            of_episode = np.concatenate(commands[begin:end])
            given[: len(of_episode), : of_episode.shape[1]] = of_episode
        starts = true[[first for first, _ in spans]]
        after = self._engine.run(model, effects, starts, control)
        for (first, last), start, states in zip(spans, starts, after, strict=True):
            path = np.concatenate([start[None], states])
            rows = self.steps * np.arange(last - first)
            paths = path[rows[:-1, None] + np.arange(self.steps + 1)]
            rates = rates_at_ends(paths, model.opt.timestep, windows(self.base, effects))
            past = past_along(path[rows], self.period)
            followed[first + 1 : last] = shown(self.base, effects, path[rows[1:]], rates, past)
        return followed

    @property
    def is_quick(self) -> bool:
        """True if `predict_quickly` simulates what `predict` does."""
        return self._rough == self.finer and is_first_order(self.base)

    @property
    def quick_steps(self) -> int:
        """Number of steps that `predict_quickly` takes from one row to the next."""
        return self.steps // self.finer * self._rough

    def predict_quickly(self, values: Vector, effects: Sequence[Effect], states: Matrix) -> Matrix:
        """`predict` in larger steps with an integrator of first order, to be compared with other
        predictions of this kind.

        Where steps are `finer`, or the model's own integrator is of fourth order, it takes a
        fraction of the time. Steps are `FINER` times as large, or the model's own, unless forces
        move joints otherwise in these, as where contacts are stiff.
        """
        return self._predict(effects, states, self._quick(values, effects))

    def quickly(
        self, predicted: Matrix, values: Vector, effects: Sequence[Effect], states: Matrix
    ) -> Matrix:
        """`predict_quickly`, where what `predict` gives is known."""
        return predicted if self.is_quick else self.predict_quickly(values, effects, states)

    def predict_finer(
        self,
        values: Vector,
        effects: Sequence[Effect],
        states: Matrix,
        finer: int,
        integrator: int,
    ) -> Matrix:
        """`predict` with a step `finer` times smaller, by one of MuJoCo's integrators."""
        model = self.model(values, effects)
        model.opt.timestep /= finer
        model.opt.integrator = integrator
        return self._predict(effects, states, model)

    def predict_free(self, values: Vector, effects: Sequence[Effect], states: Matrix) -> Matrix:
        """`predict_quickly` without contacts and joint limits in the step that is predicted."""
        model = self._quick(values, effects)
        true = self._true(effects, states, model)
        bits = mujoco.mjtDisableBit
        model.opt.disableflags |= bits.mjDSBL_CONTACT | bits.mjDSBL_LIMIT
        return self.sensors.after(effects, self._paths(effects, true, model))

    def predict_pushed(
        self, values: Vector, effects: Sequence[Effect], states: Matrix, dof: int, force: float
    ) -> Matrix:
        """`predict_quickly` with a constant generalised force [N or N m] on a degree of freedom."""
        model = self._quick(values, effects)
        return self._predict(effects, states, model, _Added(dof=dof, force=force))

    def responses_to_forces(
        self, values: Vector, effects: Sequence[Effect], states: Matrix
    ) -> list[Matrix]:
        """For each degree of freedom, what a unit of force on it [1/N or 1/(N m)] changes of
        `predict_quickly` (N, 2 nv); NaN where it diverges."""
        known = (values, effects, states)
        predicted = self.predict_quickly(*known)
        return [
            (self.predict_pushed(*known, dof, size) - predicted) / size
            for dof, size in enumerate(self._sizes.tolist())
        ]

    def predict_unclamped(
        self, values: Vector, effects: Sequence[Effect], states: Matrix, actuator: int, more: float
    ) -> Matrix:
        """`predict_quickly` with larger commands to an actuator, and no limits of commands."""
        model = self._quick(values, effects)
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        return self._predict(effects, states, model, _Added(actuator=actuator, command=more))

    def largest_command(self, actuator: int) -> float:
        """Largest recorded command to an actuator, in its unit; one if it was never moved."""
        return float(np.abs(self.data.ctrl[self.starts, actuator]).max()) or 1.0

    def commands(self, effects: Sequence[Effect], steps: int) -> Array3:
        """(N, steps, nu) what the actuators obey in each of so many steps between two rows."""
        return self._commands(tuple(e for e in effects if acts_on_commands([e])), steps)

    def _commands_after(self, effects: tuple[Effect, ...], steps: int) -> Array3:
        count = self.data.ctrl.shape[1]  # without actuators that an extension added
        limited = obeys_limits(self.base)[:count]
        bounds = self.base.actuator_ctrlrange[:count].T
        low, high = np.where(limited, bounds, [[-np.inf], [np.inf]])
        within = self.data.ctrl_within
        if within is None or steps == 1:
            within = self.data.ctrl[:, None]
        given = np.clip(within[self.starts], low, high)  # as the simulator would
        commands = np.repeat(given, steps // given.shape[1], axis=1)
        for rows in self._of_equal_length() if effects else ():
            given = commands[rows].reshape(len(rows), -1, count)
            changed = obeyed(self.base, effects, given, self.period / steps)
            commands[rows] = changed.reshape(*rows.shape, steps, count)
        commands.flags.writeable = False  # they are kept
        return commands

    def rates(self, values: Vector, effects: Sequence[Effect], states: Matrix) -> Matrix:
        """(rows, 2 nv) rate of change just before each row, by the model of `predict_quickly`; at
        an episode's first row, just after it.

        Over what the effects need of it, else over a step. Simulated: the measured rate would
        reveal to the simulator what it is to predict.
        """
        model = self._quick(values, effects)
        true = self._true(effects, states, model)
        return self.sensors.rates(effects, self._paths(effects, true, model))

    def model(self, values: Vector, effects: Sequence[Effect]) -> mujoco.MjModel:
        """A model of the caller's own with these parameters and effects, and with its step."""
        nominal = self.nominal
        with quiet():
            bare = self._bare(nominal.lengths(values), elements_of(effects))
            model = nominal.completed(bare, values, effects)
        model.opt.timestep /= self.finer
        return model

    @cached_property
    def sensors(self) -> Sensors:
        """The robot's sensors, with the past of each position."""
        return Sensors(self.base, self.data, lambda: self._nominal_ends)

    @cached_property
    def _nominal_ends(self) -> Matrix:
        """(N, 2 nv) measured states one control step later by the nominal model, or as measured
        where that diverges."""
        ends = self.predict_quickly(self.nominal.start, (), self.measured)
        return np.where(np.isfinite(ends), ends, self.measured[self.starts + 1])

    @cached_property
    def _rough(self) -> int:
        """Steps that `predict_quickly` takes for one of the model's: larger ones than its own, if
        forces move their joints in these about as in the finer ones."""
        larger = max(1, self.finer // FINER)
        if larger == self.finer:
            return larger
        fine, coarse = (self._own_velocities(each) for each in (self.finer, larger))
        simulated = np.all(np.isfinite(fine), axis=1)
        fine, coarse = fine[simulated], coarse[simulated]
        missed = np.linalg.norm(coarse - fine, axis=0)  # NaN where they alone diverge
        is_enough = np.all(missed <= _MISSED * np.linalg.norm(fine, axis=0))
        return larger if simulated.any() and is_enough else self.finer

    def _own_velocities(self, finer: int) -> Matrix:
        """(N, nv) velocity that a unit of force gives each joint, in so many steps for one."""
        model = self._quick(self.nominal.start, (), finer)
        predicted = self._predict((), self.measured, model)
        own: list[Vector] = []
        for dof, size in enumerate(self._sizes.tolist()):
            pushed = self._predict((), self.measured, model, _Added(dof=dof, force=size))
            own.append((pushed - predicted)[:, self.base.nq + dof] / size)
        return np.stack(own, axis=1)

    @property
    def _sizes(self) -> Vector:
        """(nv,) forces [N or N m] that each move a joint a little within a control step."""
        return 0.01 * self.base.dof_M0 / self.period

    def _quick(
        self, values: Vector, effects: Sequence[Effect], rough: int | None = None
    ) -> mujoco.MjModel:
        model = self.model(values, effects)
        model.opt.timestep *= self.finer / (rough or self._rough)
        if not is_first_order(model):
            model.opt.integrator = other_integrator(model.opt.integrator)
        return model

    def _predict(
        self,
        effects: Sequence[Effect],
        states: Matrix,
        model: mujoco.MjModel,
        added: _Added | None = None,
    ) -> Matrix:
        true = self._true(effects, states, model)
        return self.sensors.after(effects, self._paths(effects, true, model, added))

    def _paths(
        self,
        effects: Sequence[Effect],
        true: Matrix,
        model: mujoco.MjModel,
        added: _Added | None = None,
    ) -> Paths:
        """The motion from each row to the next, from the robot's states (rows, 2 nv) at the rows
        on."""
        steps, n = round(self.period / model.opt.timestep), len(self.starts)
        self.simulated_steps += n
        starts = true[self.starts]
        if not self._is_possible(model):
            nowhere = np.full((n, steps + 1, self.measured.shape[1]), np.nan)
            return Paths(true, nowhere, model.opt.timestep)
        added = added or _Added()
        commands = self.commands(effects, steps)
        control = np.zeros((n, steps, model.nu + model.nv))
        control[..., : commands.shape[2]] = commands
        control[..., added.actuator] += added.command
        control[..., model.nu + added.dof] = added.force
        after = self._engine.run(model, effects, starts, control)
        states = np.concatenate([starts[:, None], after], axis=1)
        return Paths(true, states, model.opt.timestep)

    def _true(self, effects: Sequence[Effect], states: Matrix, model: mujoco.MjModel) -> Matrix:
        """The robot's states (rows, 2 nv) behind what its sensors show."""
        rates = np.zeros_like(states)
        if windows(self.base, effects):
            rates = self.sensors.rates(effects, self._paths(effects, states, model))
        return behind(self.base, effects, states, rates, self.sensors.past)

    def _is_possible(self, model: mujoco.MjModel) -> bool:
        """True if every body that has a mass and inertias in the base model still has them."""
        before, after = _bodies(self.base), _bodies(model)
        pairs = (
            (self.base.body_mass[before], model.body_mass[after]),
            (self.base.body_inertia[before], model.body_inertia[after]),
        )
        return all(np.all((now > mujoco.mjMINVAL) | (was == 0)) for was, now in pairs)

    def _of_equal_length(self) -> list[Indices]:
        """Transitions (e, n) of all episodes that have n of them, for each n."""
        by_length: dict[int, list[Indices]] = {}
        for first, last in self.transitions():
            by_length.setdefault(last - first, []).append(np.arange(first, last))
        return [np.stack(rows) for rows in by_length.values()]

    def transitions(self) -> list[tuple[int, int]]:
        """Half-open ranges of each episode's transitions among `starts`."""
        lengths = [last - first - 1 for first, last in self.data.spans()]
        ends = np.cumsum(lengths).tolist()
        return [(end - length, end) for end, length in zip(ends, lengths, strict=True)]


def is_first_order(model: mujoco.MjModel) -> bool:
    """True unless the model's integrator is Runge-Kutta's, of fourth order."""
    return bool(model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4)


def other_integrator(integrator: int) -> int:
    """An integrator of another kind: the implicit one or, in its place, Runge-Kutta's."""
    kinds = mujoco.mjtIntegrator
    implicit = kinds.mjINT_IMPLICITFAST
    return int(kinds.mjINT_RK4 if integrator == implicit else implicit)


def _bodies(model: mujoco.MjModel) -> list[int]:
    """Numbers of the bodies that no mechanism added."""
    return [i for i in range(model.nbody) if not is_added(model.body(i).name)]

"""Many simulations of one source at once, each with its own dynamics.

    simulations = Simulations(task, source, n=12)
    simulations.set_dynamics(draws.values)          # (12, d) SI units
    simulations.set_state(task.initial(12, rng))
    simulations.step(actions)                       # one C++ call for all
    observations = task.observe(simulations.state)

Results do not depend on the number of threads, and a step depends on the state alone (no warm
start). A simulation that diverges, by MuJoCo's own criterion (not finite, or beyond 1e10), becomes
NaN and stays NaN; the others go on unchanged.

Fields that a task derives from the state (`Task.derived`) are those of the last stage of the last
integration step, as in Gymnasium's environments.
"""

from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from adr_service.arrays import Indices, Mask, Matrix, frozen
from adr_service.effects.base import is_added
from adr_service.effects.friction import VaryingFriction, uses_torques, varies
from adr_service.effects.models import (
    apply,
    check_simulated,
    make_inertias_explicit,
    name_all,
    prepared,
)
from adr_service.errors import InvalidInput
from adr_service.progress import Progress, silent
from adr_service.simulation.links import LinkLengths
from adr_service.simulation.model import (
    Slot,
    Writer,
    addresses_of,
    compiled,
    differs,
    link_of,
    links_of,
    resolve,
    write,
)
from adr_service.tasks.base import Source, State, Task

_LARGEST = mujoco.mjMAXVAL  # MuJoCo's own bound of positions and velocities


class Simulations:
    """n simulations of a task's source on `threads` threads."""

    def __init__(self, task: Task, source: Source, n: int, threads: int = 1):
        self.n = n
        self._task = task
        self._lengths = LinkLengths(task, source) if links_of(source) else None
        self._effects = _Effects(task, source) if source.effects else None
        changed = self._effects or self._lengths
        model = compiled(task.xml) if changed is None else changed.base
        _check(task, model)
        self._batch = Batch(model, n, threads)
        self._friction = (
            VaryingFriction(self._batch, model, source.effects) if varies(source.effects) else None
        )
        self._rows = np.arange(n)
        if self._lengths:
            self._lengths.expand(self._batch)
        parameters = [p.address for p in source.space.parameters]
        self._writer = Writer(self._batch, _slots(model, parameters))
        self._fixed = Writer(self._batch, _slots(model, list(source.fixed)))
        self._fixed_values = np.tile(list(source.fixed.values()), (n, 1))
        self._fixed.write(self._fixed_values, self._rows)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")[:, : len(task.action_low)]  # effects add more
        if self._effects:
            self._effects.expand(self._batch)
        self._derived = [self._batch.bind(name) for name in task.derived]
        self._no_derived = np.empty((n, 0))
        self._stale = np.zeros(n, dtype=np.bool_)  # true where derived fields are of another state
        self._diverged = np.zeros(n, dtype=np.bool_)
        self.dynamics = np.full((n, len(source.space)), np.nan)  # (n, d), NaN until set

    @property
    def state(self) -> State:
        """A copy of the states of all simulations."""
        if not self._derived:
            return State(self._qpos.copy(), self._qvel.copy(), self._no_derived)
        if self._stale.any():
            self._ctrl[self._stale] = 0.0
            self._batch.forward(np.flatnonzero(self._stale))
            self._stale[:] = False
        derived = np.concatenate([array.reshape(self.n, -1) for array in self._derived], axis=1)
        derived[self._diverged] = np.nan
        return State(self._qpos.copy(), self._qvel.copy(), derived)

    @property
    def diverged(self) -> Mask:
        """(n,) true where a simulation has diverged since its state was set."""
        return self._diverged.copy()

    def model(self, row: int) -> mujoco.MjModel:
        """A copy of one simulation's model, for rendering or for MuJoCo's own functions."""
        return self._batch.get_model(row)

    def set_dynamics(self, values: Matrix, rows: Indices | None = None) -> None:
        """Give simulations (`rows`, or all) their parameters, (n, d) in SI units.

        Constants that MuJoCo derives from them (subtree masses, inverse weights) follow.
        """
        given, width = frozen(values), self.dynamics.shape[1]
        count = self.n if rows is None else len(rows)
        if given.shape != (count, width) or not np.all(np.isfinite(given)):
            raise InvalidInput(f"dynamics must be finite and ({count}, {width}); given {given}")
        chosen = self._rows if rows is None else rows
        if self._lengths is not None:
            self._lengths.write(given, chosen)  # may overwrite fixed values
            self._fixed.write(self._fixed_values[chosen], chosen)
        self._writer.write(given, chosen)
        if self._effects is not None:
            self._effects.write(given, chosen)
        if self._friction is not None:
            self._friction.reset(chosen)
        self._batch.set_const(rows)
        self.dynamics[chosen] = given

    def set_state(self, state: State, rows: Indices | None = None) -> None:
        """Put simulations (`rows`, or all) into full states."""
        chosen = slice(None) if rows is None else rows
        self._qpos[chosen] = state.qpos
        self._qvel[chosen] = state.qvel
        if self._friction is not None:
            self._friction.reset(chosen)
        self._stale[chosen] = True
        self._diverged[chosen] = False

    def step(self, actions: Matrix) -> None:
        """Advance all simulations by one control step under `actions` (n, a) or (a,)."""
        shapes = self._ctrl.shape, self._ctrl.shape[1:]
        # MuJoCo would take what is not finite for zero
        if actions.shape not in shapes or not np.isfinite(actions.sum()):
            raise InvalidInput(f"actions must be finite, of shape {shapes[0]}; given {actions}")
        self._ctrl[:] = actions
        if self._friction is None:
            self._batch.step(nstep=self._task.frame_skip)
        else:
            self._friction.step(self._task.frame_skip)
        self._stale[:] = False
        # nearly always none has, and one maximum is the fastest test
        if not (np.abs(self._qpos).max() < _LARGEST and np.abs(self._qvel).max() < _LARGEST):
            self._diverged = ~(
                (np.abs(self._qpos) < _LARGEST).all(axis=1)
                & (np.abs(self._qvel) < _LARGEST).all(axis=1)
            )
            self._qpos[self._diverged] = np.nan
            self._qvel[self._diverged] = np.nan


def check_effects(task: Task, source: Source) -> None:
    """Raises InvalidInput unless the source's effects can be simulated."""
    if source.effects:
        _Effects(task, source)


class _Effects:
    """The models of a task with effects that its file lacks, on top of all parameters."""

    def __init__(self, task: Task, source: Source):
        if links := links_of(source):
            raise InvalidInput(
                f"{task.name} with the lengths of {', '.join(links)} as parameters cannot be "
                "extended by effects: its shape is compiled anew for every draw"
            )
        drives = [a for a in addresses_of(source) if a.startswith("actuator:")]
        if drives and uses_torques(source.effects):
            raise InvalidInput(
                f"{task.name} has {', '.join(drives)} among its parameters or fixed values; a "
                "friction that depends on load knows the drives of the file alone. Remove the "
                "effect, or these addresses"
            )
        self._added = source.effects
        spec = mujoco.MjSpec.from_string(task.xml)
        name_all(spec)
        check_simulated(spec.copy().compile(), source.effects)
        make_inertias_explicit(spec)
        self._bare = prepared(spec, source.effects)
        self.base = copy(self._bare)
        apply(self.base, source.effects)
        if self.base.nu > compiled(task.xml).nu and "qfrc_actuator" in task.derived:
            raise InvalidInput(
                f"{task.name} observes its actuators' forces, among which effects that "
                "are actuators of their own would stand: they are not possible there"
            )
        alone, whole = (mujoco.MjData(each) for each in (compiled(task.xml), self.base))
        shifted = [n for n in task.derived if getattr(alone, n).size != getattr(whole, n).size]
        if shifted:
            raise InvalidInput(
                f"{task.name} observes {', '.join(shifted)} of all its bodies, and the effects add "
                "bodies, which would shift these columns: give effects that add none"
            )
        self._slots = [resolve(self._bare, address) for address in addresses_of(source)]
        self._fixed = list(source.fixed.values())
        _check_masses(self._extended(source.space.feasible_low.tolist()), source)
        changed = {name for name in MODEL_FIELDS if differs(self._bare, self.base, name)}
        # an effect on what a parameter gives may show no difference at the file's own value
        given = {name for slot in self._slots for name in (slot.field, slot.scaled) if name}
        self._fields = sorted(changed | given)
        self._expanded: list[NDArray[Any]] = []  # of a batch

    def expand(self, batch: Batch) -> None:
        """Let the simulations of a batch have effects that depend on their parameters."""
        self._expanded = [batch.expand(name) for name in self._fields]

    def write(self, dynamics: Matrix, rows: Indices) -> None:
        """Give simulations `rows` the effects, a row of `dynamics` each."""
        for row, draw in zip(rows.tolist(), dynamics.tolist(), strict=True):
            model = self._extended(draw)
            for array, name in zip(self._expanded, self._fields, strict=True):
                array[row] = getattr(model, name)

    def _extended(self, draw: Sequence[float]) -> mujoco.MjModel:
        model = copy(self._bare)
        for slot, value in zip(self._slots, [*self._fixed, *draw], strict=True):
            write(model, slot, value)
        apply(model, self._added)
        return model


def _check_masses(model: mujoco.MjModel, source: Source) -> None:
    """Raise InvalidInput if a body of the lightest robot that may be drawn has a negative mass."""
    masses = np.minimum(model.body_mass, model.body_inertia.min(axis=1))
    if masses.min() < 0:
        name = model.body(int(masses.argmin())).name
        lowest = dict(zip(source.space.names, source.space.feasible_low.tolist(), strict=True))
        raise InvalidInput(
            f"effects {source.effects} leave {name} with a negative mass or inertia where the "
            f"parameters are smallest ({lowest}): accepted are effects that take less, or a source "
            "that draws no such robot"
        )


def _slots(model: mujoco.MjModel, addresses: Sequence[str]) -> dict[int, Slot]:
    """Slots by the position of their address; link lengths have none."""
    return {
        i: resolve(model, address)
        for i, address in enumerate(addresses)
        if link_of(address) is None
    }


def _check(task: Task, model: mujoco.MjModel) -> None:
    """Raise InvalidInput if the task's parts do not fit, or its model breaks our promises."""
    bits = mujoco.mjtDisableBit
    needed = int(bits.mjDSBL_WARMSTART) | int(bits.mjDSBL_AUTORESET)
    if model.opt.disableflags & needed != needed:
        raise InvalidInput(
            f'the model of {task.name} needs <option><flag warmstart="disable" '
            'autoreset="disable"/></option>: a step may depend on the state alone, and a '
            "diverged simulation must be seen"
        )
    if model.na or model.nhistory:
        raise InvalidInput(
            f"the model of {task.name} has actuators or sensors with a state of their own "
            "(activations, as of dyntype or timeconst, or delays); a step may depend on positions, "
            "velocities and commands alone"
        )
    controls = sum(not is_added(model.actuator(i).name) for i in range(model.nu))
    if not len(task.action_low) == len(task.action_high) == controls:
        raise InvalidInput(
            f"{task.name} bounds {len(task.action_low)} and {len(task.action_high)} actions; its "
            f"model has {controls} controls"
        )
    if not 0 < task.measured <= len(task.columns):
        raise InvalidInput(f"{task.name} measures {task.measured} of {len(task.columns)} columns")


def control_period(task: Task) -> float:
    """Seconds between two actions of a task."""
    return compiled(task.xml).opt.timestep * task.frame_skip


class Batches:
    """Simulations of one source under any number of dynamics, at most `most` at a time.

    What is left over has a batch of its own size, so that nothing is simulated in vain.
    """

    def __init__(self, task: Task, source: Source, most: int, threads: int = 1):
        self._simulations_of = partial(Simulations, task, source, threads=threads)
        self._whole = self._rest = self._simulations_of(most)

    def run(
        self,
        simulate: Callable[[Simulations], np.ndarray],
        dynamics: Matrix,
        progress: Progress = silent,
    ) -> np.ndarray:
        """Simulate dynamics (n, d) in batches, and return one row for each of them."""
        found: list[np.ndarray] = []
        for first in range(0, len(dynamics), self._whole.n):
            found.append(simulate(self._under(dynamics[first : first + self._whole.n])))
            progress(min(first + self._whole.n, len(dynamics)) / len(dynamics))
        return np.concatenate(found)

    def _under(self, dynamics: Matrix) -> Simulations:
        count = len(dynamics)
        if count not in (self._whole.n, self._rest.n):
            self._rest = self._simulations_of(count)
        simulations = self._whole if count == self._whole.n else self._rest
        simulations.set_dynamics(dynamics)
        return simulations

"""Many simulations of one source at once, each with its own dynamics.

    simulations = Simulations(task, source, n=12)
    simulations.set_dynamics(draws.values)          # (12, d) SI units
    simulations.set_state(task.initial(12, rng))
    simulations.step(actions)                       # one C++ call for all
    observations = task.observe(simulations.state)

The one file that knows `mujoco.batch`. Results do not depend on the number of threads, and a
step depends on the state alone (no warm start). A simulation that diverges, by MuJoCo's own
criterion (not finite, or beyond 1e10), becomes NaN and stays NaN; the others are unharmed.

A draw of link lengths is compiled, and what differs is copied into the batch; all other
parameters are written in place. Fields that a task derives from the state (`Task.derived`) are
those of the last stage of the last integration step, as Gymnasium's environments have them.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from adr_service.arrays import Indices, Mask, Matrix, frozen
from adr_service.effects.base import is_added
from adr_service.effects.models import apply, check_simulated, make_inertias_explicit, prepared
from adr_service.errors import InvalidInput
from adr_service.simulation.model import Slot, Writer, link_of, resolve, write
from adr_service.tasks.base import Reshapable, Source, State, Task

_LARGEST = mujoco.mjMAXVAL  # MuJoCo's own bound of positions and velocities


class Simulations:
    """n simulations of a task's source on `threads` threads."""

    def __init__(self, task: Task, source: Source, n: int, threads: int = 1):
        self.n = n
        self._task = task
        self._shape = _Shape(task, source) if _links(source) else None
        self._effects = _Effects(task, source) if source.effects else None
        model = compiled(task.xml)
        if self._shape:
            model = self._shape.base
        if self._effects:
            model = self._effects.base
        _check(task, model)
        self._batch = Batch(model, n, threads)
        self._rows = np.arange(n)
        if self._shape:
            self._shape.expand(self._batch)
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
        self._unseen = np.zeros(n, dtype=np.bool_)  # whose derived fields are of another state
        self._diverged = np.zeros(n, dtype=np.bool_)
        self.dynamics = np.full((n, len(source.space)), np.nan)  # (n, d), NaN until set

    @property
    def state(self) -> State:
        """A copy of the states of all simulations."""
        if not self._derived:
            return State(self._qpos.copy(), self._qvel.copy(), self._no_derived)
        if self._unseen.any():
            self._ctrl[self._unseen] = 0.0
            self._batch.forward(np.flatnonzero(self._unseen))
            self._unseen[:] = False
        derived = np.concatenate([array.reshape(self.n, -1) for array in self._derived], axis=1)
        derived[self._diverged] = np.nan
        return State(self._qpos.copy(), self._qvel.copy(), derived)

    @property
    def diverged(self) -> Mask:
        """(n,) whether a simulation has diverged since its state was set."""
        return self._diverged.copy()

    def model(self, row: int) -> mujoco.MjModel:
        """A copy of one simulation's model, to render it or to give it to MuJoCo."""
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
        if self._shape is not None:
            self._shape.write(given, chosen)  # which may move what is fixed
            self._fixed.write(self._fixed_values[chosen], chosen)
        self._writer.write(given, chosen)
        if self._effects is not None:
            self._effects.write(given, chosen)
        self._batch.set_const(rows)
        self.dynamics[chosen] = given

    def set_state(self, state: State, rows: Indices | None = None) -> None:
        """Put simulations (`rows`, or all) into full states."""
        chosen = slice(None) if rows is None else rows
        self._qpos[chosen] = state.qpos
        self._qvel[chosen] = state.qvel
        self._unseen[chosen] = True
        self._diverged[chosen] = False

    def step(self, actions: Matrix) -> None:
        """Advance all simulations by one control step under `actions` (n, a) or (a,)."""
        shapes = self._ctrl.shape, self._ctrl.shape[1:]
        # MuJoCo would take what is not finite for zero
        if actions.shape not in shapes or not np.isfinite(actions.sum()):
            raise InvalidInput(f"actions must be finite, of shape {shapes[0]}; given {actions}")
        self._ctrl[:] = actions
        self._batch.step(nstep=self._task.frame_skip)
        self._unseen[:] = False
        # nearly always none has, and that is found fastest
        if not (np.abs(self._qpos).max() < _LARGEST and np.abs(self._qvel).max() < _LARGEST):
            self._diverged = ~(
                (np.abs(self._qpos) < _LARGEST).all(axis=1)
                & (np.abs(self._qvel) < _LARGEST).all(axis=1)
            )
            self._qpos[self._diverged] = np.nan
            self._qvel[self._diverged] = np.nan


class _Shape:
    """The models of a task with other link lengths than its file has."""

    def __init__(self, task: Task, source: Source):
        links = _links(source)
        if not isinstance(task, Reshapable):
            raise InvalidInput(
                f"{task.name} cannot be reshaped, so the lengths of {', '.join(links)} cannot be "
                "parameters; give the task a method `reshape`"
            )
        if scaled := [a for a in _addresses(source) if a.endswith(".inertial")]:
            raise InvalidInput(
                f"{', '.join(scaled)} would scale an inertia that a length changes too; where "
                "lengths are parameters, use body:….mass"
            )
        self._task = task
        fixed = {link_of(address): value for address, value in source.fixed.items()}
        self._fixed = {link: value for link, value in fixed.items() if link is not None}
        self._columns = {
            link: source.space.index(p.name)
            for p in source.space.parameters
            if (link := link_of(p.address)) is not None
        }
        spec, self._bare = mujoco.MjSpec.from_string(task.xml), _without_textures(task.xml)
        self.base = self._compiled(spec, {})  # the file's lengths, where the source fixes none
        for link, length in self._fixed.items():
            self._moved(link, length, 1.1 * length)
        ranges = {link: source.space.parameters[i] for link, i in self._columns.items()}
        moved = [self._moved(link, p.low, p.high) for link, p in ranges.items()]
        self._fields: list[str] = sorted(set().union(*moved))
        self._expanded: list[NDArray[Any]] = []  # of a batch

    def _moved(self, link: str, short: float, long: float) -> set[str]:
        """The model fields that the length of a link changes."""
        one, other = (self._compiled(self._bare, {link: length}) for length in (short, long))
        fields = {name for name in MODEL_FIELDS if _differs(one, other, name)}
        if not fields:
            raise InvalidInput(
                f"link:{link}.length changes nothing: {self._task.name} reshapes no such link"
            )
        return fields

    def expand(self, batch: Batch) -> None:
        """Let the simulations of a batch have geometries of their own."""
        self._expanded = [batch.expand(name) for name in self._fields]

    def _compiled(self, spec: mujoco.MjSpec, lengths: Mapping[str, float]) -> mujoco.MjModel:
        self._task.reshape(spec, {**self._fixed, **lengths})
        try:
            return spec.compile()
        except ValueError as error:
            raise InvalidInput(f"lengths {lengths} of {self._task.name}: {error}") from error

    def write(self, dynamics: Matrix, rows: Indices) -> None:
        """Give simulations `rows` the geometry of their draws, a row of `dynamics` each."""
        lengths = dynamics[:, list(self._columns.values())]
        for draw in lengths if len(rows) == 1 else np.unique(lengths, axis=0):
            model = self._compiled(self._bare, dict(zip(self._columns, draw.tolist(), strict=True)))
            same = rows[np.all(lengths == draw, axis=1)]
            for array, name in zip(self._expanded, self._fields, strict=True):
                array[same] = getattr(model, name)


def check_effects(task: Task, source: Source) -> None:
    """Raises InvalidInput unless the source's effects can be simulated."""
    if source.effects:
        _Effects(task, source)


class _Effects:
    """The models of a task with effects that its file lacks, on top of all parameters."""

    def __init__(self, task: Task, source: Source):
        check_simulated(compiled(task.xml), source.effects)
        if links := _links(source):
            raise InvalidInput(
                f"{task.name} with the lengths of {', '.join(links)} as parameters cannot be "
                "extended by effects: its shape is compiled anew for every draw"
            )
        self._added = source.effects
        spec = mujoco.MjSpec.from_string(task.xml)
        make_inertias_explicit(spec)
        self._bare = prepared(spec, source.effects)
        self.base = copy(self._bare)
        apply(self.base, source.effects)
        if self.base.nu > compiled(task.xml).nu and "qfrc_actuator" in task.derived:
            raise InvalidInput(
                f"{task.name} observes its actuators' forces, among which asymmetric friction and "
                "external forces would stand: they are not possible there"
            )
        if min(self.base.body_mass.min(), self.base.body_inertia.min()) < 0:
            raise InvalidInput(f"effects {source.effects} leave a body with a negative mass")
        self._slots = [resolve(self._bare, address) for address in _addresses(source)]
        self._fixed = list(source.fixed.values())
        changed = {name for name in MODEL_FIELDS if _differs(self._bare, self.base, name)}
        scaled = {slot.scaled for slot in self._slots if slot.scaled is not None}
        self._fields = sorted(changed | scaled)
        self._expanded: list[NDArray[Any]] = []  # of a batch

    def expand(self, batch: Batch) -> None:
        """Let the simulations of a batch have effects that depend on their parameters."""
        self._expanded = [batch.expand(name) for name in self._fields]

    def write(self, dynamics: Matrix, rows: Indices) -> None:
        """Give simulations `rows` the effects, a row of `dynamics` each."""
        for row, draw in zip(rows.tolist(), dynamics.tolist(), strict=True):
            model = copy(self._bare)
            for slot, value in zip(self._slots, [*self._fixed, *draw], strict=True):
                write(model, slot, value)
            apply(model, self._added)
            for array, name in zip(self._expanded, self._fields, strict=True):
                array[row] = getattr(model, name)


def _without_textures(xml: str) -> mujoco.MjSpec:
    """A model without what only pictures need, which is most of its compilation."""
    spec = mujoco.MjSpec.from_string(xml)
    for geom in spec.geoms:
        geom.material = ""
    for asset in (*spec.materials, *spec.textures):
        spec.delete(asset)
    return spec


def _differs(one: mujoco.MjModel, other: mujoco.MjModel, field: str) -> bool:
    return not field.startswith("opt.") and not np.array_equal(
        getattr(one, field), getattr(other, field)
    )


def _slots(model: mujoco.MjModel, addresses: Sequence[str]) -> dict[int, Slot]:
    """Slots by the position of their address, but for lengths."""
    return {
        i: resolve(model, address)
        for i, address in enumerate(addresses)
        if link_of(address) is None
    }


def _addresses(source: Source) -> list[str]:
    return [*source.fixed, *(p.address for p in source.space.parameters)]


def _links(source: Source) -> list[str]:
    return [link for address in _addresses(source) if (link := link_of(address)) is not None]


def _check(task: Task, model: mujoco.MjModel) -> None:
    """Refuse a task whose parts do not fit, or whose model hides what the engine promises."""
    bits = mujoco.mjtDisableBit
    needed = int(bits.mjDSBL_WARMSTART) | int(bits.mjDSBL_AUTORESET)
    if model.opt.disableflags & needed != needed:
        raise InvalidInput(
            f'the model of {task.name} needs <option><flag warmstart="disable" '
            'autoreset="disable"/></option>: a step may depend on the state alone, and a '
            "diverged simulation must be seen"
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


@lru_cache(maxsize=32)
def compiled(xml: str) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise InvalidInput(f"MuJoCo cannot compile the model: {error}") from error

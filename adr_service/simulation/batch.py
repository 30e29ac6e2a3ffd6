"""Many simulations of one source at once, each with its own dynamics.

    simulations = Simulations(task, source, n=12)
    simulations.set_dynamics(draws.values)          # (12, d) SI units
    simulations.set_state(task.initial(12, rng))
    simulations.step(actions)                       # one C++ call for all
    observations = task.observe(simulations.state)

The one file that knows `mujoco.batch`. Results do not depend on the number of threads, and a
step depends on the state alone (no warm start). A diverged simulation becomes NaN and stays
NaN; the others are unharmed.

A draw of link lengths is compiled, and what differs is copied into the batch; all other
parameters are written in place. Fields that a task derives from the state (`Task.derived`) are
those of the last stage of the last integration step, as Gymnasium's environments have them.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from adr_service.arrays import Indices, Mask, Matrix, frozen
from adr_service.errors import InvalidInput
from adr_service.simulation.model import Slot, Writer, link_of, resolve
from adr_service.tasks.base import Reshapable, Source, State, Task


class Simulations:
    """n simulations of a task's source on `threads` threads."""

    def __init__(self, task: Task, source: Source, n: int, threads: int = 1):
        self.n = n
        self._task = task
        self._shape = _Shape(task, source) if _links(source) else None
        model = self._shape.base if self._shape else compiled(task.xml)
        self._batch = Batch(model, n, threads)
        self._rows = np.arange(n)
        if self._shape:
            self._shape.expand(self._batch)
        parameters = [p.address for p in source.space.parameters]
        self._writer = Writer(self._batch, _slots(model, parameters))
        fixed = Writer(self._batch, _slots(model, list(source.fixed)))
        fixed.write(np.tile(list(source.fixed.values()), (n, 1)), self._rows)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        self._derived = [self._batch.bind(name) for name in task.derived]
        self._no_derived = np.empty((n, 0))
        self.dynamics = np.full((n, len(source.space)), np.nan)  # (n, d), NaN until set

    @property
    def state(self) -> State:
        """A copy of the states of all simulations."""
        if not self._derived:
            return State(self._qpos.copy(), self._qvel.copy(), self._no_derived)
        derived = np.concatenate([array.reshape(self.n, -1) for array in self._derived], axis=1)
        return State(self._qpos.copy(), self._qvel.copy(), derived)

    @property
    def diverged(self) -> Mask:
        """(n,) whether a simulation is no longer finite."""
        if np.isfinite(self._qpos.sum() + self._qvel.sum()):  # nearly always
            return np.zeros(self.n, dtype=np.bool_)
        finite: Mask = np.isfinite(self._qpos.sum(axis=1) + self._qvel.sum(axis=1))
        return ~finite

    def model(self, row: int) -> mujoco.MjModel:
        """A copy of one simulation's model, to render it or to give it to MuJoCo."""
        return self._batch.get_model(row)

    def set_dynamics(self, values: Matrix, rows: list[int] | None = None) -> None:
        """Give simulations (`rows`, or all) their parameters, (n, d) in SI units.

        Constants that MuJoCo derives from them (subtree masses, inverse weights) follow.
        """
        given, width = frozen(values), self.dynamics.shape[1]
        count = self.n if rows is None else len(rows)
        if given.shape != (count, width) or not np.all(np.isfinite(given)):
            raise InvalidInput(f"dynamics must be finite and ({count}, {width}); given {given}")
        chosen = self._rows if rows is None else self._rows[rows]
        if self._shape is not None:
            self._shape.write(given, chosen)
        self._writer.write(given, chosen)
        self._batch.set_const(rows)
        self.dynamics[chosen] = given

    def set_state(self, state: State, rows: list[int] | None = None) -> None:
        """Put simulations (`rows`, or all) into full states."""
        chosen = slice(None) if rows is None else rows
        self._qpos[chosen] = state.qpos
        self._qvel[chosen] = state.qvel
        if self._derived:
            self._ctrl[chosen] = 0.0
            self._batch.forward(rows)

    def step(self, actions: Matrix) -> None:
        """Advance all simulations by one control step under `actions` (n, a) or (a,)."""
        if not np.isfinite(actions.sum()):  # MuJoCo would take them for zero
            raise InvalidInput(f"actions must be finite; given {actions}")
        self._ctrl[:] = actions
        self._batch.step(nstep=self._task.frame_skip)


class _Shape:
    """The models of a task with other link lengths than its file has."""

    def __init__(self, task: Task, source: Source):
        links = _links(source)
        if not isinstance(task, Reshapable):
            raise InvalidInput(
                f"{task.name} cannot be reshaped, so the lengths of {', '.join(links)} cannot be "
                "parameters; give the task a method `reshape`"
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
        other = self._compiled(self._bare, dict.fromkeys(links, _OTHER_LENGTH_M))
        nominal = self._compiled(self._bare, {})
        self._fields = [name for name in MODEL_FIELDS if _differs(nominal, other, name)]
        self._expanded: list[NDArray[Any]] = []  # of a batch

    def expand(self, batch: Batch) -> None:
        """Let the simulations of a batch have geometries of their own."""
        self._expanded = [batch.expand(name) for name in self._fields]

    def _compiled(self, spec: mujoco.MjSpec, lengths: Mapping[str, float]) -> mujoco.MjModel:
        self._task.reshape(spec, {**lengths, **self._fixed})
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


_OTHER_LENGTH_M = 0.777  # any length no link has, to see which fields a length changes


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


def _links(source: Source) -> list[str]:
    addresses = [*source.fixed, *(p.address for p in source.space.parameters)]
    return [link for address in addresses if (link := link_of(address)) is not None]


def control_period(task: Task) -> float:
    """Seconds between two actions of a task."""
    return compiled(task.xml).opt.timestep * task.frame_skip


@lru_cache(maxsize=32)
def compiled(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)

"""Many simulations of one source at once, each with its own dynamics.

    simulations = Simulations(task, source, n=12)
    simulations.set_dynamics(draws.values)          # (12, d) SI units
    simulations.set_state(task.initial(12, rng))
    simulations.step(actions)                       # one C++ call for all
    observations = task.observe(simulations.state)

The one file that knows `mujoco.batch`. Results do not depend on the number of threads, and a
step depends on the state alone (no warm start). A diverged simulation becomes NaN and stays
NaN; the others are unharmed.
"""

from functools import lru_cache

import mujoco
import numpy as np
from mujoco.batch import Batch

from adr_service.arrays import Mask, Matrix, frozen
from adr_service.errors import InvalidInput
from adr_service.simulation.model import resolve, write
from adr_service.tasks.base import Source, State, Task


class Simulations:
    """n simulations of a task's source on `threads` threads."""

    def __init__(self, task: Task, source: Source, n: int, threads: int = 1):
        model = compiled(task.xml)
        self.n = n
        self._task = task
        self._slots = [resolve(model, p.address) for p in source.space.parameters]
        self._batch = Batch(model, n, threads)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._ctrl = self._batch.bind("ctrl")
        for address, value in source.fixed.items():
            write(self._batch, resolve(model, address), np.full(n, value), slice(None))
        self.dynamics = np.full((n, len(self._slots)), np.nan)  # (n, d), NaN until set

    @property
    def state(self) -> State:
        """A copy of the states of all simulations."""
        return State(self._qpos.copy(), self._qvel.copy())

    @property
    def diverged(self) -> Mask:
        """(n,) whether a simulation is no longer finite."""
        return ~np.isfinite(self._qpos.sum(axis=1) + self._qvel.sum(axis=1))

    def model_field(self, name: str) -> Matrix:
        """A copy of a field of MjModel in every simulation, (n, ...)."""
        expanded = self._batch.expanded(name)
        if expanded is not None:
            return expanded.copy()
        shared = getattr(self._batch.model, name)
        return np.broadcast_to(shared, (self.n, *shared.shape)).copy()

    def set_dynamics(self, values: Matrix, rows: list[int] | None = None) -> None:
        """Give simulations (`rows`, or all) their parameters, (n, d) in SI units.

        Constants that MuJoCo derives from them (subtree masses, inverse weights) follow.
        """
        given = frozen(values)
        count = self.n if rows is None else len(rows)
        if given.shape != (count, len(self._slots)) or not np.all(np.isfinite(given)):
            raise InvalidInput(
                f"dynamics must be finite and ({count}, {len(self._slots)}); given {given}"
            )
        chosen = slice(None) if rows is None else rows
        for column, slot in enumerate(self._slots):
            write(self._batch, slot, given[:, column], chosen)
        self._batch.set_const(rows)
        self.dynamics[chosen] = given

    def set_state(self, state: State, rows: list[int] | None = None) -> None:
        """Put simulations (`rows`, or all) into full states."""
        chosen = slice(None) if rows is None else rows
        self._qpos[chosen] = state.qpos
        self._qvel[chosen] = state.qvel

    def step(self, actions: Matrix) -> None:
        """Advance all simulations by one control step under `actions` (n, a) or (a,)."""
        self._ctrl[:] = actions
        self._batch.step(nstep=self._task.frame_skip)


def control_period(task: Task) -> float:
    """Seconds between two actions of a task."""
    return compiled(task.xml).opt.timestep * task.frame_skip


@lru_cache(maxsize=32)
def compiled(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)

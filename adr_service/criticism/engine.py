"""Many simulations at once, each from a state of its own under commands of its own.

    engine = Engine(base, threads)
    states = engine.run(model, effects, starts, control)      # (n, steps, 2 nv)

It is `mujoco.rollout`: one model for all, in one call. Where a friction differs from simulation to
simulation, and from step to step, it is `mujoco.batch`, which does the same to the last bit.
"""

import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from mujoco import rollout
from mujoco.batch import Batch

from adr_service.arrays import Array3, Matrix
from adr_service.effects.base import Effect
from adr_service.effects.friction import VaryingFriction, varies

_CONTROL = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)


class Engine:
    """Threads that simulate a model, its variants, and extensions of it."""

    def __init__(self, base: mujoco.MjModel, threads: int | None):
        """`threads`: None for as many as there are cores."""
        self._base = base
        self._threads = len(os.sched_getaffinity(0)) if threads is None else threads
        count = 0 if self._threads == 1 else self._threads
        self._pool = rollout.Rollout(nthread=count)
        self._scratch = [mujoco.MjData(base) for _ in range(max(1, count))]

    def close(self) -> None:
        """End the threads."""
        self._pool.close()

    def run(
        self, model: mujoco.MjModel, effects: Sequence[Effect], starts: Matrix, control: Array3
    ) -> Array3:
        """States (n, steps, 2 nv) after each step from `starts` (n, 2 nv), NaN once a simulation
        diverges: beyond MuJoCo's bound of states and accelerations.

        `control` (n, steps, nu + nv): commands, then generalised forces. Simulates the effects that
        the `model` has already, and frictions that vary.
        """
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # divergence must show
        with quiet():
            simulate = self._step_by_step if varies(effects) else self._roll_out
            after = simulate(model, effects, starts, control)
        speeds = np.concatenate([starts[:, None], after], axis=1)[..., model.nq :]
        with np.errstate(over="ignore", invalid="ignore"):  # between infinities
            jumps = np.abs(np.diff(speeds, axis=1)) / model.opt.timestep
        largest = np.maximum(np.abs(after).max(axis=2), jumps.max(axis=2))  # NaN stays one
        is_sane = np.logical_and.accumulate(largest < mujoco.mjMAXVAL, axis=1)
        return np.where(is_sane[..., None], after, np.nan)

    def _roll_out(
        self, model: mujoco.MjModel, effects: Sequence[Effect], starts: Matrix, control: Array3
    ) -> Array3:
        full = np.column_stack([np.zeros(len(starts)), starts])
        times_and_states, _ = self._pool.rollout(
            model, self._data(model), full, control, control_spec=_CONTROL
        )
        after = times_and_states[..., 1:]
        # at a warning of divergence it stops, and repeats time and state
        is_stopped = np.diff(times_and_states[..., 0], axis=1, prepend=0.0) <= 0
        return np.where(is_stopped[..., None], np.nan, after)

    def _step_by_step(
        self, model: mujoco.MjModel, effects: Sequence[Effect], starts: Matrix, control: Array3
    ) -> Array3:
        batch = Batch(model, len(starts), max(1, self._threads))
        friction = VaryingFriction(batch, model, effects)
        qpos, qvel, ctrl, applied = map(batch.bind, ("qpos", "qvel", "ctrl", "qfrc_applied"))
        qpos[:], qvel[:] = np.split(starts, [model.nq], axis=1)
        after = np.empty((*control.shape[:2], starts.shape[1]))
        for step in range(control.shape[1]):
            ctrl[:], applied[:] = np.split(control[:, step], [model.nu], axis=1)
            friction.step(1)
            after[:, step] = np.column_stack([qpos, qvel])
        return after

    def _data(self, model: mujoco.MjModel) -> list[mujoco.MjData]:
        if model.nbuffer == self._base.nbuffer and model.names == self._base.names:
            return self._scratch  # no mechanism has added anything
        return [mujoco.MjData(model) for _ in self._scratch]


@contextmanager
def quiet() -> Generator[None]:
    """Drop MuJoCo's warnings of divergence, which would go to the terminal and to a file; we see
    a divergence as NaN."""
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)

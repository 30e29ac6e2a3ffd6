"""Targets that hide effects, and the effects that criticism names."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from adr_service.blind_test.planting import hide
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import criticise
from adr_service.effects.base import Effect
from adr_service.tasks.catalogue import get_task, source_of


def arm():
    return get_task("arm"), Nominal.of_task(get_task("arm"), source_of("arm", "vanilla"))


def recorded(measurement):
    """Arrays of a measurement by name."""
    names = ("time", "qpos", "qvel", "ctrl", "episode")
    return {name: getattr(measurement, name) for name in names}


def driven(model: mujoco.MjModel, noise: float) -> dict[str, np.ndarray]:
    """Arrays of twelve episodes of one joint under random commands, with noise of its position
    [rad] and, ten times as much, of its velocity."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    rows: list[tuple[float, ...]] = []
    for episode in range(12):
        mujoco.mj_resetData(model, data)
        data.qpos[0] = rng.uniform(-1, 1)
        for _ in range(75):
            data.ctrl[0] = rng.uniform(-1, 1)
            q, v = (data.qpos[0], data.qvel[0]) + noise * np.array([1, 10]) * rng.normal(size=2)
            rows.append((episode, data.time, q, v, data.ctrl[0]))
            mujoco.mj_step(model, data, nstep=5)
    episode, time, qpos, qvel, ctrl = (column[:, None] for column in np.array(rows).T)
    ids = episode[:, 0].astype(int)
    return {"time": time[:, 0], "qpos": qpos, "qvel": qvel, "ctrl": ctrl, "episode": ids}


def named_effects(
    task: str, variant: str, effects: Sequence[Effect], seed: int
) -> list[dict[str, Any]]:
    """Effects that criticism names, as a spec takes them."""
    truth = Nominal.of_task(get_task(task), source_of(task, "vanilla"))
    data = hide(get_task(task), truth, np.random.default_rng(seed), effects)
    nominal = Nominal.of_task(get_task(task), source_of(task, variant))
    found = criticise(nominal, data, np.random.default_rng(0), threads=1)
    assert found.extension is not None
    return [
        {"kind": c.kind, "location": c.location, "values": list(c.values)}
        for c in found.extension.effects
    ]

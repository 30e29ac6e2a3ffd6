"""Targets that hide effects, and the effects that criticism names."""

from collections.abc import Sequence
from typing import Any

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

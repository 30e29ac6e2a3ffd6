"""Policies of every kind, of a task."""

from itertools import pairwise

import numpy as np
import pytest

from adr_service.tasks.catalogue import get_task
from adr_service.training.policy import Policy


@pytest.fixture(scope="session", params=["tanh", "clip", "bins"])
def squash(request):
    return request.param


@pytest.fixture(scope="session", params=["arm", "humanoid"])
def task(request):
    return get_task(request.param)


@pytest.fixture(scope="session")
def policy(task, squash):
    rng = np.random.default_rng(0)
    s, a = len(task.columns), len(task.action_low)
    widths = [s, 64, 32, a * (11 if squash == "bins" else 1)]
    layers = tuple(
        (
            rng.normal(size=(after, before)).astype(np.float32) / np.float32(before**0.5),
            rng.normal(size=after).astype(np.float32),
        )
        for before, after in pairwise(widths)
    )
    activation = "relu" if squash == "tanh" else "tanh"
    return Policy(layers, activation, task.action_low, task.action_high, squash)


@pytest.fixture(scope="session")
def observations(task):
    return np.random.default_rng(1).normal(size=(200, len(task.columns)))

"""The interface of a training library, and help with the two: SB3 on PyTorch, SBX on JAX."""

import importlib
from collections.abc import Mapping
from functools import cache
from typing import Any, Protocol

import numpy as np

from adr_service.errors import InvalidInput
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.startup_time import add_preparation, preparing
from adr_service.tasks.base import Task
from adr_service.training.networks import Networks
from adr_service.training.policy import Layer, Policy, Squash
from adr_service.training.settings import check_backend
from adr_service.training.xla import on_one_thread


class Library(Protocol):
    """A library's implementation of an algorithm, with the interface of SB3."""

    def build(self, env: RandomizedVecEnv, task: Task, settings: Any, seed: int) -> Any: ...
    def policy(self, model: Any, task: Task, settings: Any) -> Policy: ...

    def networks(self, model: Any) -> Networks:
        """The networks and statistics from which another training can continue."""
        ...

    def load(self, model: Any, networks: Networks) -> None:
        """Put networks in the place of a model's first ones; they are of the same settings."""
        ...


def torch_activation(name: str) -> Any:
    """A PyTorch activation; makes PyTorch use one thread."""
    with preparing():
        import torch

    torch.set_num_threads(1)
    return {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh}[name]


def jax_activation(name: str) -> Any:
    """A Flax activation; makes JAX use one thread.

    Raises InvalidInput where SBX is not installed.
    """
    check_backend("sbx")
    with preparing():
        on_one_thread()
        importlib.import_module("sbx")
        import flax.linen
    _count_compilations()
    return {"relu": flax.linen.relu, "tanh": flax.linen.tanh}[name]


@cache
def _count_compilations() -> None:
    """Count the time that JAX spends on compiling as preparation, once per process."""
    import jax

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith("/jax/core/compile/") and "trace" not in event:  # traces are nested
            add_preparation(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)


def torch_layer(linear: Any) -> Layer:
    """The weights of a PyTorch `Linear`, copied."""
    return linear.weight.detach().numpy().copy(), linear.bias.detach().numpy().copy()


def flax_layer(dense: Mapping[str, Any]) -> Layer:
    """The weights of a Flax `Dense`, copied."""
    return np.array(dense["kernel"]).T.copy(), np.array(dense["bias"])


def normalised(layer: Layer, mean: np.ndarray, scale: np.ndarray, shift: Any = 0.0) -> Layer:
    """The layer for x that does what the given one does for (x - mean) * scale + shift.

    All three have the width of the input, or are one number.
    """
    weight, bias = layer
    moved = bias + weight @ (shift - mean * scale)
    return (weight * scale).astype(np.float32), moved.astype(np.float32)


def without_constants(scale: np.ndarray, variance: np.ndarray, least: np.ndarray) -> np.ndarray:
    """The scale (s,) of observations, set to zero where the variance is not above the least.

    A policy cannot learn from a column that is constant in its whole training. Divided by almost no
    deviation, another constant on the target would drown all other observations. Humanoid observes
    masses, for example, and the unmodeled variant freezes four of them (docs/decisions.md).
    """
    return np.where(variance > least, scale, 0.0)


def actor(
    task: Task, activation: str, layers: tuple[Layer, ...], squash: Squash = "tanh"
) -> Policy:
    """The policy of an actor's layers; raises InvalidInput where they are not finite."""
    if not all(np.isfinite(weight).all() and np.isfinite(bias).all() for weight, bias in layers):
        raise InvalidInput("training diverged: the actor's weights are not finite")
    return Policy(layers, activation, task.action_low, task.action_high, squash)

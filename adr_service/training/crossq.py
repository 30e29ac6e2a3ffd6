"""CrossQ (Bhatt et al., arXiv 1902.05605), by SB3-Contrib and by SBX.

Batch renormalisation precedes every layer. An acting policy uses its running statistics, which make
it linear, so the exported policy has each renormalisation folded into the layer that follows.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.base import Task
from adr_service.training.libraries import (
    Library,
    actor,
    flax_layer,
    jax_activation,
    normalised,
    torch_activation,
    torch_layer,
    without_constants,
)
from adr_service.training.networks import OffPolicyFlax, OffPolicyTorch
from adr_service.training.policy import Layer, Policy
from adr_service.training.settings import CrossQSettings

_EPSILON = 0.001  # of both libraries, added to variances
# Variances of observations that were constant: they start at 1 and fall by a hundredth per update,
# and SBX subtracts the squared mean in float32
_LEAST, _LEAST_SHARE = 1e-9, 1e-6


def _hyperparameters(settings: CrossQSettings, activation: Any, seed: int) -> dict[str, Any]:
    return {
        "learning_rate": settings.learning_rate,
        "buffer_size": settings.capacity,
        "learning_starts": settings.learning_starts,
        "batch_size": settings.batch_size,
        "gamma": settings.gamma,
        "train_freq": 1,
        "gradient_steps": settings.gradient_steps,
        "policy_delay": settings.policy_delay,
        "seed": seed,
        "policy_kwargs": {
            "net_arch": {"pi": settings.hidden, "qf": settings.critic_hidden},
            "activation_fn": activation,
        },
    }


def _renormalised(
    layers: Sequence[Layer], renormalisations: Sequence[Sequence[Any]]
) -> tuple[Layer, ...]:
    """Layers with the batch renormalisations before them: mean, variance, factor and shift."""
    found: list[Layer] = []
    for layer, numbers in zip(layers, renormalisations, strict=True):
        mean, variance, factor, shift = map(np.asarray, numbers)
        scale = factor / np.sqrt(variance + _EPSILON)
        if not found:  # of observations
            scale = without_constants(scale, variance, _LEAST + _LEAST_SHARE * mean**2)
        found.append(normalised(layer, mean, scale, shift))
    return tuple(found)


class _Sb3(OffPolicyTorch):
    """SB3-Contrib (PyTorch): the reference."""

    def build(self, env: RandomizedVecEnv, task: Task, settings: CrossQSettings, seed: int) -> Any:
        activation = torch_activation(settings.activation)
        import sb3_contrib

        common = _hyperparameters(settings, activation, seed)
        return sb3_contrib.CrossQ("MlpPolicy", env, device="cpu", **common)

    def policy(self, model: Any, task: Task, settings: CrossQSettings) -> Policy:
        import torch
        from sb3_contrib.common.torch_layers import BatchRenorm1d

        found = model.policy.actor
        linear = [m for m in found.latent_pi if isinstance(m, torch.nn.Linear)] + [found.mu]
        before = [m for m in found.latent_pi if isinstance(m, BatchRenorm1d)]
        numbers = [
            [x.detach().numpy() for x in (norm.ra_mean, norm.ra_var, norm.scale, norm.bias)]
            for norm in before
        ]
        layers = _renormalised([torch_layer(layer) for layer in linear], numbers)
        return actor(task, settings.activation, layers)


class _Sbx(OffPolicyFlax):
    """SBX (JAX): the same interface with more updates per second."""

    def build(self, env: RandomizedVecEnv, task: Task, settings: CrossQSettings, seed: int) -> Any:
        activation = jax_activation(settings.activation)
        from adr_service.training.fused import FusedCrossQ

        return FusedCrossQ("MlpPolicy", env, **_hyperparameters(settings, activation, seed))

    def policy(self, model: Any, task: Task, settings: CrossQSettings) -> Policy:
        model.publish()
        state = model.policy.actor_state
        # the last Dense, the log deviation, follows the same renormalisation as the mean
        count = range(len(settings.hidden) + 1)
        numbers = [
            (seen["mean"], seen["var"], norm["scale"], norm["bias"])
            for norm, seen in (
                (state.params[f"BatchRenorm_{i}"], state.batch_stats[f"BatchRenorm_{i}"])
                for i in count
            )
        ]
        layers = _renormalised([flax_layer(state.params[f"Dense_{i}"]) for i in count], numbers)
        return actor(task, settings.activation, layers)


LIBRARIES: Mapping[str, Library] = {"sbx": _Sbx(), "sb3": _Sb3()}

"""Soft Actor-Critic (Haarnoja et al., arXiv 1812.05905), by SB3 and by SBX."""

from collections.abc import Mapping
from typing import Any

from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.base import Task
from adr_service.training.libraries import (
    Library,
    actor,
    flax_layer,
    jax_activation,
    torch_activation,
    torch_layer,
)
from adr_service.training.networks import OffPolicyFlax, OffPolicyTorch
from adr_service.training.policy import Policy
from adr_service.training.settings import SacSettings


def _hyperparameters(task: Task, settings: SacSettings, seed: int) -> dict[str, Any]:
    return {
        "learning_rate": settings.learning_rate or task.learning_rate,
        "buffer_size": settings.capacity,
        "learning_starts": settings.learning_starts,
        "batch_size": settings.batch_size,
        "tau": settings.tau,
        "gamma": settings.gamma,
        "train_freq": 1,
        "gradient_steps": settings.gradient_steps,
        "seed": seed,
    }


class _Sb3(OffPolicyTorch):
    """Stable-Baselines3 (PyTorch): the reference."""

    def build(self, env: RandomizedVecEnv, task: Task, settings: SacSettings, seed: int) -> Any:
        activation = torch_activation(settings.activation)
        import stable_baselines3

        kwargs = {"net_arch": settings.hidden, "activation_fn": activation}
        common = _hyperparameters(task, settings, seed)
        return stable_baselines3.SAC("MlpPolicy", env, policy_kwargs=kwargs, device="cpu", **common)

    def policy(self, model: Any, task: Task, settings: SacSettings) -> Policy:
        import torch

        found = model.policy.actor
        linear = [m for m in found.latent_pi if isinstance(m, torch.nn.Linear)] + [found.mu]
        return actor(task, settings.activation, tuple(torch_layer(m) for m in linear))


class _Sbx(OffPolicyFlax):
    """SBX (JAX), by the authors of SB3: the same interface with more updates per second."""

    def build(self, env: RandomizedVecEnv, task: Task, settings: SacSettings, seed: int) -> Any:
        activation = jax_activation(settings.activation)
        from adr_service.training.fused import FusedSac

        kwargs = {"net_arch": settings.hidden, "activation_fn": activation}
        common = _hyperparameters(task, settings, seed)
        return FusedSac("MlpPolicy", env, policy_kwargs=kwargs, **common)

    def policy(self, model: Any, task: Task, settings: SacSettings) -> Policy:
        model.publish()
        dense = model.policy.actor_state.params["params"]
        # Dense_0 .. Dense_{k-1} hidden, Dense_k the mean, Dense_{k+1} the log deviation
        layers = tuple(flax_layer(dense[f"Dense_{i}"]) for i in range(len(dense) - 1))
        return actor(task, settings.activation, layers)


LIBRARIES: Mapping[str, Library] = {"sbx": _Sbx(), "sb3": _Sb3()}

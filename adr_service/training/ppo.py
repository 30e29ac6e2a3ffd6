"""Proximal Policy Optimisation (Schulman et al., arXiv 1707.06347), by SB3 and by SBX.

Observations and rewards are normalised. The exported policy has the normalisation in its first
layer. Actions are those of the unit cube, scaled to the task's bounds, so that the first policies
of every task explore with the same strength. Each may be one of a few evenly spaced values
(`action_bins`; Tang and Agrawal, arXiv 1901.10500): such policies explore the bounds, too. In that
paper a policy takes the most likely value. The exported one takes the mean, which does not jump
where two values are as likely.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnvWrapper, VecNormalize

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
from adr_service.training.networks import (
    Networks,
    flax_networks,
    load_moments,
    load_torch,
    moments,
    restored_flax,
    torch_networks,
)
from adr_service.training.policy import Policy, Squash
from adr_service.training.settings import PpoSettings

_START = 1e-4  # weight with which SB3's running statistics start, in observations
_ROUNDING = 1e-12  # of a variance, relative to the squared mean


class _UnitActions(VecEnvWrapper):
    """Environments whose actions are those of the unit cube, [-1, 1] each, or numbers of bins."""

    def __init__(self, env: RandomizedVecEnv, task: Task, bins: int | None):
        self._low, self._high, self._bins = task.action_low, task.action_high, bins
        space = gymnasium.spaces.Box(-1.0, 1.0, self._low.shape)
        if bins is not None:
            space = gymnasium.spaces.MultiDiscrete([bins] * len(self._low))
        super().__init__(env, action_space=space)

    def reset(self) -> Any:
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        if self._bins is None:
            share = (np.clip(actions, -1, 1) + 1) / 2
        else:
            share = actions / (self._bins - 1)
        self.venv.step_async(self._low + share * (self._high - self._low))

    def step_wait(self) -> Any:
        return self.venv.step_wait()


def _hyperparameters(settings: PpoSettings, activation: Any, seed: int) -> dict[str, Any]:
    rate = settings.learning_rate
    end = {"constant": rate, "linear": 0.0}[settings.learning_rate_schedule]
    return {
        "learning_rate": LinearSchedule(rate, end, end_fraction=1.0),
        "n_steps": settings.rollout_steps,
        "batch_size": settings.batch_size,
        "n_epochs": settings.epochs,
        "gamma": settings.gamma,
        "gae_lambda": settings.gae_lambda,
        "clip_range": settings.clip_range,
        "ent_coef": settings.entropy_coefficient,
        "seed": seed,
        "policy_kwargs": {
            "net_arch": {"pi": settings.hidden, "vf": settings.hidden},
            "activation_fn": activation,
            "log_std_init": settings.log_deviation,
            "ortho_init": settings.ortho_init,
        },
    }


def _squash(settings: PpoSettings) -> Squash:
    return "clip" if settings.action_bins is None else "bins"


def _least(seen: RunningMeanStd) -> np.ndarray:
    """The variances (s,) of constant columns: what is left of the start at mean 0, variance 1."""
    if seen.count <= _START:  # nothing has been seen
        return np.zeros_like(seen.var)
    start = _START * (1 + seen.mean**2) / seen.count
    return 1.001 * start + _ROUNDING * seen.mean**2


class _Sb3:
    """Stable-Baselines3 (PyTorch): the reference, with its `VecNormalize`."""

    def build(self, env: RandomizedVecEnv, task: Task, settings: PpoSettings, seed: int) -> Any:
        activation = torch_activation(settings.activation)
        import stable_baselines3

        normal = VecNormalize(
            _UnitActions(env, task, settings.action_bins),
            gamma=settings.gamma,
            clip_obs=np.inf,
            clip_reward=np.inf,
        )
        common = _hyperparameters(settings, activation, seed)
        return stable_baselines3.PPO("MlpPolicy", normal, device="cpu", **common)

    def policy(self, model: Any, task: Task, settings: PpoSettings) -> Policy:
        import torch

        found, normal = model.policy, model.get_vec_normalize_env()
        inner = found.mlp_extractor.policy_net
        linear = [m for m in inner if isinstance(m, torch.nn.Linear)] + [found.action_net]
        first, *others = (torch_layer(layer) for layer in linear)
        seen = normal.obs_rms
        scale = without_constants(1 / np.sqrt(seen.var + normal.epsilon), seen.var, _least(seen))
        layers = (normalised(first, seen.mean, scale), *others)
        return actor(task, settings.activation, layers, _squash(settings))

    def networks(self, model: Any) -> Networks:
        return torch_networks(model.policy) | moments(**self._statistics(model))

    def load(self, model: Any, networks: Networks) -> None:
        load_torch(model.policy, networks)
        load_moments(networks, **self._statistics(model))

    def _statistics(self, model: Any) -> dict[str, RunningMeanStd]:
        normal = model.get_vec_normalize_env()
        return {"observations": normal.obs_rms, "returns": normal.ret_rms}


class _Sbx:
    """SBX (JAX): the same interface with more steps per second."""

    def build(self, env: RandomizedVecEnv, task: Task, settings: PpoSettings, seed: int) -> Any:
        activation = jax_activation(settings.activation)
        from adr_service.training.fused_ppo import FusedPpo

        common = _hyperparameters(settings, activation, seed)
        return FusedPpo("MlpPolicy", _UnitActions(env, task, settings.action_bins), **common)

    def policy(self, model: Any, task: Task, settings: PpoSettings) -> Policy:
        dense = model.policy.actor_state.params["params"]
        count = len(settings.hidden) + 1
        first, *others = (flax_layer(dense[f"Dense_{i}"]) for i in range(count))
        mean, scale = model.normalisation
        seen = model.statistics["observations"]
        scale = without_constants(scale, seen.var, _least(seen))
        layers = (normalised(first, mean, scale), *others)
        return actor(task, settings.activation, layers, _squash(settings))

    def networks(self, model: Any) -> Networks:
        policy = model.policy
        kept = flax_networks(actor=policy.actor_state, critic=policy.vf_state)
        return kept | moments(**model.statistics)

    def load(self, model: Any, networks: Networks) -> None:
        policy = model.policy
        policy.actor_state = restored_flax("actor", policy.actor_state, networks)
        policy.vf_state = restored_flax("critic", policy.vf_state, networks)
        load_moments(networks, **model.statistics)


LIBRARIES: Mapping[str, Library] = {"sbx": _Sbx(), "sb3": _Sb3()}

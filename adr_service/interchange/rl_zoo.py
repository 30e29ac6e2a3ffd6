"""Policies and learning curves as a folder of RL Baselines3 Zoo.

    write_zoo_folder(Path("logs"), policy, "hopper", "vanilla", curve)

makes `logs/sac/adr-RandomHopper-v0_1/` with `best_model.zip`, a model of Stable-Baselines3 that
acts as the policy does, `evaluations.npz`, and the configuration that the Zoo looks for. The
evaluations have one column of results: the mean over the episodes of a point.
"""

import json
from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from adr_service.errors import InvalidInput
from adr_service.tasks.gymnasium_ids import gymnasium_id
from adr_service.training.policy import Layer, Policy

_ALGORITHMS = {"tanh": "sac", "clip": "ppo"}  # in SB3, by how they squash actions


def write_zoo_folder(
    logs: Path, policy: Policy, task: str, variant: str, curve: Sequence[Mapping[str, Any]]
) -> Path:
    """Write the folder of the next number under `logs`, and return it.

    `curve` has the environment `steps` and the undiscounted `mean_return` of each evaluation of
    the policy's training. Raises InvalidInput for a policy of bins, which SB3 does not have.
    """
    if policy.squash not in _ALGORITHMS:
        raise InvalidInput("a policy of action bins has no counterpart in Stable-Baselines3")
    algorithm, env = _ALGORITHMS[policy.squash], gymnasium_id(task, variant)
    name = env.replace("/", "-")
    folders = (logs / algorithm / f"{name}_{number}" for number in count(1))
    folder = next(each for each in folders if not each.exists())
    model = as_sb3(policy, task, variant)
    (folder / name).mkdir(parents=True)
    model.save(folder / "best_model.zip")
    np.savez(
        folder / "evaluations.npz",
        timesteps=np.array([point["steps"] for point in curve], dtype=np.int64),
        results=np.array([[point["mean_return"]] for point in curve]),
    )
    args = {"algo": algorithm, "env": env, "env_kwargs": None}
    about = {"args.yml": args, "config.yml": {"policy": "MlpPolicy"}}
    for file, values in about.items():
        (folder / name / file).write_text(json.dumps(values) + "\n")  # JSON is YAML
    return folder


def as_sb3(policy: Policy, task: str, variant: str) -> Any:
    """A model of SB3 (SAC or PPO) that predicts the policy's actions, (n, a) from (n, s)."""
    from stable_baselines3 import PPO, SAC  # seconds
    from torch import nn

    from adr_service.simulation.gym_env import RandomizedEnv

    shape = {
        "activation_fn": {"relu": nn.ReLU, "tanh": nn.Tanh}[policy.activation],
        "net_arch": [len(bias) for _, bias in policy.layers[:-1]],
    }
    env = RandomizedEnv(task, variant)
    if policy.squash == "tanh":
        model = SAC("MlpPolicy", env, policy_kwargs=shape, buffer_size=1, device="cpu")
        actor = model.policy.actor
        _load([*actor.latent_pi, actor.mu], policy.layers)
        return model
    model = PPO("MlpPolicy", env, policy_kwargs=shape, device="cpu")
    last = _in_bounds(policy)
    _load(
        [*model.policy.mlp_extractor.policy_net, model.policy.action_net],
        (*policy.layers[:-1], last),
    )
    return model


def _in_bounds(policy: Policy) -> Layer:
    """The last layer with outputs in the unit of the actions, to which SB3's PPO clips them."""
    weight, bias = policy.layers[-1]
    half = ((policy.action_high - policy.action_low) / 2).astype(np.float32)
    middle = ((policy.action_high + policy.action_low) / 2).astype(np.float32)
    return half[:, None] * weight, half * bias + middle


def _load(modules: Sequence[Any], layers: Sequence[Layer]) -> None:
    """Put weights (out, in) and biases (out,) into the linear modules among `modules`."""
    import torch

    linear = [module for module in modules if isinstance(module, torch.nn.Linear)]
    for module, (weight, bias) in zip(linear, layers, strict=True):
        module.load_state_dict({"weight": torch.tensor(weight), "bias": torch.tensor(bias)})

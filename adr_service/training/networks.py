"""Networks and running statistics, from which another training can continue.

Optimisers and replay buffers are left out: they belong to the distribution that was trained on.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import safetensors.numpy
from stable_baselines3.common.running_mean_std import RunningMeanStd

Networks = dict[str, np.ndarray]
_KEPT = ("params", "target_params", "batch_stats")  # of Flax's states


def to_bytes(networks: Networks) -> bytes:
    """A safetensors file."""
    return safetensors.numpy.save(networks)


def from_bytes(content: bytes) -> Networks:
    """The networks of `to_bytes`."""
    return safetensors.numpy.load(content)


class OffPolicyTorch:
    """Networks of SB3's SAC and CrossQ."""

    def networks(self, model: Any) -> Networks:
        temperature = model.log_ent_coef.detach().numpy().copy()
        return {"temperature": temperature, **torch_networks(model.policy)}

    def load(self, model: Any, networks: Networks) -> None:
        import torch

        load_torch(model.policy, networks)
        with torch.no_grad():
            model.log_ent_coef.copy_(torch.as_tensor(networks["temperature"]))


class OffPolicyFlax:
    """Networks of our fused SAC and CrossQ, on SBX."""

    def networks(self, model: Any) -> Networks:
        model.publish()
        policy = model.policy
        return flax_networks(
            critics=policy.qf_state, actor=policy.actor_state, temperature=model.ent_coef_state
        )

    def load(self, model: Any, networks: Networks) -> None:
        policy = model.policy
        policy.qf_state = restored_flax("critics", policy.qf_state, networks)
        policy.actor_state = restored_flax("actor", policy.actor_state, networks)
        model.ent_coef_state = restored_flax("temperature", model.ent_coef_state, networks)
        model.adopt()


def torch_networks(policy: Any) -> Networks:
    """The arrays of a PyTorch policy, copied."""
    return {name: tensor.numpy().copy() for name, tensor in policy.state_dict().items()}


def load_torch(policy: Any, networks: Networks) -> None:
    """Copy networks to a PyTorch policy."""
    import torch

    policy.load_state_dict({name: torch.as_tensor(networks[name]) for name in policy.state_dict()})


def flax_networks(**states: Any) -> Networks:
    """The arrays of Flax's states, copied."""
    import jax

    return {
        f"{name}.{kept}.{i}": np.array(leaf)
        for name, state in states.items()
        for kept in _KEPT
        for i, leaf in enumerate(jax.tree.leaves(getattr(state, kept, None)))
    }


def restored_flax(name: str, state: Any, networks: Networks) -> Any:
    """A Flax state with the arrays that `flax_networks` stored under its name."""
    import jax

    changed: dict[str, Any] = {}
    for kept in (each for each in _KEPT if hasattr(state, each)):
        tree = jax.tree.structure(getattr(state, kept))
        leaves = [jax.numpy.asarray(networks[f"{name}.{kept}.{i}"]) for i in range(tree.num_leaves)]
        changed[kept] = jax.tree.unflatten(tree, leaves)
    return state.replace(**changed)


def moments(**statistics: RunningMeanStd) -> Networks:
    """The means, variances and counts of running statistics."""
    return {
        f"{name}.{moment}": np.array(getattr(running, moment))
        for name, running in statistics.items()
        for moment in ("mean", "var", "count")
    }


def load_moments(networks: Mapping[str, np.ndarray], **statistics: RunningMeanStd) -> None:
    """Put what `moments` has kept in the place of running statistics."""
    for name, running in statistics.items():
        running.mean, running.var = networks[f"{name}.mean"], networks[f"{name}.var"]
        running.count = float(networks[f"{name}.count"])

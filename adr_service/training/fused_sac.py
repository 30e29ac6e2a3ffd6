"""SBX's SAC with one compiled call per step: the same update with less overhead.

SBX's own `train` calls a compiled update and then the compiled actor, each with some seventy
arrays in nested dataclasses. It converts batches to PyTorch and back, and copies its losses from
the device. That takes a sixth of a step's time for networks of our size, and SBX has no settings
against it, so this class overrides the methods that SB3 calls (docs/decisions.md). Here a batch
goes from the replay buffer's arrays straight into one compiled function, which updates the
networks by SBX's own `_train` and draws the next actions from SBX's own actor.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import sbx
from jax.tree_util import tree_flatten, tree_unflatten
from sbx.common.type_aliases import ReplayBufferSamplesNp

Arrays = list[jax.Array]


class FusedSac(sbx.SAC):
    """SAC with a constant learning rate, one-step returns and no dropout; logs no losses.

    Call `learn` once per model, and `publish` before any other use of its policy.
    """

    def _setup_model(self) -> None:
        super()._setup_model()
        self._arrays, self._tree = tree_flatten(self._learned)
        self._compiled: dict[int, Callable[..., tuple[Arrays, jax.Array]]] = {}
        self._next_actions: jax.Array | None = None

    @property
    def _learned(self) -> tuple[Any, ...]:
        return (self.policy.qf_state, self.policy.actor_state, self.ent_coef_state, self.key)

    def train(self, gradient_steps: int, batch_size: int) -> None:
        """Update `gradient_steps` times, then draw the next actions from the updated actor."""
        step = self._compiled.get(gradient_steps)
        if step is None:
            step = self._compiled[gradient_steps] = self._compile(gradient_steps)
        batch = self._sample(gradient_steps * batch_size)
        self._arrays, self._next_actions = step(self._arrays, batch, self._last_obs)
        self._n_updates += gradient_steps

    def publish(self) -> None:
        """Copy the learned arrays to `policy`, for all uses but `train`."""
        learned = tree_unflatten(self._tree, self._arrays)
        self.policy.qf_state, self.policy.actor_state, self.ent_coef_state, self.key = learned

    def _compile(self, gradient_steps: int) -> Callable[..., tuple[Arrays, jax.Array]]:
        tree, tau, entropy = self._tree, self.tau, self.target_entropy
        update = type(self)._train

        @jax.jit
        def step(
            arrays: Arrays, batch: ReplayBufferSamplesNp, observations: jax.Array
        ) -> tuple[Arrays, jax.Array]:
            critics, actor, temperature, key = tree_unflatten(tree, arrays)
            critics, actor, temperature, key, _ = update(
                tau, entropy, gradient_steps, batch, 1, 0, critics, actor, temperature, key
            )
            key, noise = jax.random.split(key)
            actions = actor.apply_fn(actor.params, observations).sample(seed=noise)
            return tree_flatten((critics, actor, temperature, key))[0], actions

        return step

    def _sample(self, n: int) -> ReplayBufferSamplesNp:
        """n uniformly drawn transitions, with the random numbers of `ReplayBuffer.sample`."""
        buffer = self.replay_buffer
        assert buffer is not None
        rows = np.random.randint(0, buffer.size(), n)  # noqa: NPY002 - SB3's generator, which we seed
        at = (rows, np.random.randint(0, buffer.n_envs, n))  # noqa: NPY002
        return ReplayBufferSamplesNp(
            buffer.observations[at],
            buffer.actions[at],
            buffer.next_observations[at],
            buffer.dones[at] * (1 - buffer.timeouts[at]),
            buffer.rewards[at],
            np.full(n, self.gamma, np.float32),
        )

    def _sample_action(
        self, learning_starts: int, action_noise: Any = None, n_envs: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """The actions within their bounds, and the same in [-1, 1]."""
        if self._next_actions is None:
            return super()._sample_action(learning_starts, action_noise, n_envs)
        unit = np.asarray(self._next_actions).clip(-1, 1)
        return self.policy.unscale_action(unit), unit

"""SBX's SAC and CrossQ with one compiled call per step: the same update with less overhead.

SBX's own `train` calls a compiled update and then the compiled actor, each with some seventy
arrays in nested dataclasses. It converts batches to PyTorch and back, and copies its losses from
the device. That takes a sixth of a step's time for networks of our size, and SBX has no settings
against it, so these classes override the methods that SB3 calls (docs/decisions.md). Here a batch
goes from the replay buffer's arrays straight into one compiled function, which updates the
networks by SBX's own functions and draws the next actions from SBX's own actor.
"""

import operator
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import sbx
from jax.tree_util import tree_flatten, tree_unflatten
from sbx.common.off_policy_algorithm import OffPolicyAlgorithmJax
from sbx.common.type_aliases import ReplayBufferSamplesNp

Arrays = list[jax.Array]
# CrossQ compiles up to so many updates one after another, as stored results were computed: a loop
# rounds differently
_UNROLLED = 12


class _Fused(OffPolicyAlgorithmJax):
    """An algorithm with a constant learning rate, one-step returns and no dropout; logs no losses.

    Call `learn` once per model, and `publish` before any other use of its policy.
    """

    @abstractmethod
    def _updated(
        self, learned: tuple[Any, ...], batch: ReplayBufferSamplesNp, steps: int, done: jax.Array
    ) -> tuple[Any, ...]:
        """Update on a batch, in `steps` equal parts; `done` updates came before.

        `learned` and what is returned: critics, actor, temperature and key.
        """
        ...

    @abstractmethod
    def _actor_variables(self, actor: Any) -> Any:
        """The variables of the actor's network, as `apply_fn` takes them."""
        ...

    def _setup_model(self) -> None:
        super()._setup_model()
        self.adopt()
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
        self._arrays, self._next_actions = step(
            self._arrays, batch, self._last_obs, self._n_updates
        )
        self._n_updates += gradient_steps

    def publish(self) -> None:
        """Copy the learned arrays to `policy`, for all uses but `train`."""
        learned = tree_unflatten(self._tree, self._arrays)
        self.policy.qf_state, self.policy.actor_state, self.ent_coef_state, self.key = learned

    def adopt(self) -> None:
        """Learn on from the arrays of `policy`: the inverse of `publish`."""
        self._arrays, self._tree = tree_flatten(self._learned)

    def _compile(self, gradient_steps: int) -> Callable[..., tuple[Arrays, jax.Array]]:
        tree = self._tree

        @jax.jit
        def step(
            arrays: Arrays, batch: ReplayBufferSamplesNp, observations: jax.Array, done: jax.Array
        ) -> tuple[Arrays, jax.Array]:
            learned = self._updated(tree_unflatten(tree, arrays), batch, gradient_steps, done)
            critics, actor, temperature, key = learned
            key, noise = jax.random.split(key)
            distribution = actor.apply_fn(self._actor_variables(actor), observations)
            learned = critics, actor, temperature, key
            return tree_flatten(learned)[0], distribution.sample(seed=noise)

        return step

    def _sample(self, n: int) -> ReplayBufferSamplesNp:
        """n uniformly drawn transitions, with the random numbers of `ReplayBuffer.sample`."""
        buffer = self.replay_buffer
        assert buffer is not None
        rows = np.random.randint(0, buffer.size(), n)  # noqa: NPY002 - SB3's generator, which we seed
        at = (rows, np.random.randint(0, buffer.n_envs, n))  # noqa: NPY002 - the same
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


class FusedSac(_Fused, sbx.SAC):
    """SBX's SAC in one compiled call per step."""

    def _updated(
        self, learned: tuple[Any, ...], batch: ReplayBufferSamplesNp, steps: int, done: jax.Array
    ) -> tuple[Any, ...]:
        update, tau, entropy = type(self)._train, self.tau, self.target_entropy
        return update(tau, entropy, steps, batch, 1, 0, *learned)[:4]

    def _actor_variables(self, actor: Any) -> Any:
        return actor.params


class FusedCrossQ(_Fused, sbx.CrossQ):
    """SBX's CrossQ in one compiled call per step."""

    def _updated(
        self, learned: tuple[Any, ...], batch: ReplayBufferSamplesNp, steps: int, done: jax.Array
    ) -> tuple[Any, ...]:
        if steps > _UNROLLED:
            return self._scanned(learned, batch, steps, done)
        for i in range(steps):
            rows = slice(i * self.batch_size, (i + 1) * self.batch_size)
            part = jax.tree.map(operator.itemgetter(rows), batch)
            learned = self._updated_once(learned, part, done + i + 1)
        return learned

    def _scanned(
        self, learned: tuple[Any, ...], batch: Any, steps: int, done: jax.Array
    ) -> tuple[Any, ...]:
        """The updates as a loop of the compiled program, which is as large for any number."""

        def update(learned: Any, given: tuple[Any, jax.Array]) -> tuple[Any, None]:
            part, count = given
            return self._updated_once(learned, part, count), None

        parts = jax.tree.map(lambda x: x.reshape(steps, self.batch_size, *x.shape[1:]), batch)
        counts = done + 1 + jax.numpy.arange(steps)
        return jax.lax.scan(update, learned, (parts, counts))[0]

    def _updated_once(
        self, learned: tuple[Any, ...], batch: Any, count: jax.Array
    ) -> tuple[Any, ...]:
        """One update, whose number is an argument of the compiled function: SBX compiles anew for
        every delay of the actor's next update."""
        critics, actor, temperature, key = learned
        entropy: Any = self.target_entropy  # a number since the model was set up
        given = (batch.observations, batch.actions, batch.next_observations)
        given = (*given, batch.rewards, batch.dones, batch.discounts)
        critics, _, key = self.update_critic(actor, critics, temperature, *given, key)

        def update_actor(actor: Any, temperature: Any, key: Any) -> tuple[Any, ...]:
            updated = self.update_actor_and_temperature(
                actor, critics, temperature, batch.observations, entropy, key
            )
            return updated[0], updated[2], updated[5]

        is_due = count % self.policy_delay == 0
        rest = jax.lax.cond(is_due, update_actor, lambda *same: same, actor, temperature, key)
        return critics, *rest

    def _actor_variables(self, actor: Any) -> Any:
        return {"params": actor.params, "batch_stats": actor.batch_stats}

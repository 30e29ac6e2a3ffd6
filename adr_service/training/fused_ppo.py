"""SBX's PPO with one compiled call per step and one per update of the networks.

SBX's own rollouts ask for values, one call per step, and convert everything to PyTorch and back;
its `train` makes one compiled call per minibatch and waits for its losses. Here acting is one
call, the values of a whole rollout are another, and all epochs over it are a third, which updates
the networks by SBX's own `_one_update`.

Observations are normalised by their running mean and deviation, rewards by the running deviation
of the discounted return, as by SB3's `VecNormalize`. But these change once per rollout (that of
rewards is applied at its end): the networks that act and those that learn see the same numbers.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import sbx
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv

_SMALL = 1e-8  # added to variances, as in `VecNormalize`


class Rollout(NamedTuple):
    """The transitions of a rollout, of all environments: what an update learns from."""

    observations: np.ndarray  # (n, s), as the simulation gives them
    actions: np.ndarray  # (n, a), as they were drawn
    advantages: np.ndarray  # (n,)
    returns: np.ndarray  # (n,)
    log_probabilities: np.ndarray  # (n,) of the actions when they were drawn


_Cut = tuple[int, int, np.ndarray]  # step, environment, last observation


class _Log:
    """A rollout of t steps of n environments, as it is being collected."""

    def __init__(self, t: int, n: int, observation_space: Any, action_space: Any):
        self.observations = np.empty((t + 1, n, *observation_space.shape), np.float32)
        self.actions = np.empty((t, n, *action_space.shape), action_space.dtype)  # as drawn
        self.log_probabilities = np.empty((t, n), np.float32)
        self.rewards = np.empty((t, n), np.float32)
        self.dones = np.empty((t, n), np.bool_)
        self.cut: list[_Cut] = []  # episodes that the time limit ended

    def note(self, step: int, rewards: np.ndarray, dones: np.ndarray, infos: Any) -> None:
        self.rewards[step], self.dones[step] = rewards, dones
        self.cut += [
            (step, i, infos[i]["terminal_observation"])
            for i in np.flatnonzero(dones).tolist()
            if infos[i]["TimeLimit.truncated"]
        ]


class FusedPpo(sbx.PPO):
    """PPO with normalised observations and rewards; logs no losses.

    Its environments take actions as they are drawn, also out of bounds.
    """

    # boxes and arrays, where SB3 has more kinds
    observation_space: Any
    action_space: Any
    _last_obs: Any

    def _setup_model(self) -> None:
        super()._setup_model()
        self._normal = RunningMeanStd(shape=self.observation_space.shape)  # of observations
        self._discounted = RunningMeanStd(shape=())  # of discounted returns
        self._return = np.zeros(self.n_envs)  # discounted, of the episode in each environment
        self._rollout: Rollout | None = None
        self._act_compiled, self._value_compiled = jax.jit(_act), jax.jit(_value)
        self._update_compiled = self._compile()

    @property
    def statistics(self) -> dict[str, RunningMeanStd]:
        """The running statistics by which observations and rewards are normalised."""
        return {"observations": self._normal, "returns": self._discounted}

    @property
    def normalisation(self) -> tuple[np.ndarray, np.ndarray]:
        """The mean of the observations, and the factor that gives them unit variance; (s,) each."""
        scale = 1 / np.sqrt(self._normal.var + _SMALL)
        return self._normal.mean.astype(np.float32), scale.astype(np.float32)

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: Any, n_rollout_steps: int
    ) -> bool:
        """Fill a rollout; false where the callback has stopped the training."""
        log = _Log(n_rollout_steps, env.num_envs, self.observation_space, self.action_space)
        actor, normal = self.policy.actor_state, self.normalisation
        for step in range(n_rollout_steps):
            log.observations[step] = self._last_obs
            drawn = self._act_compiled(actor, normal, log.observations[step], self.key)
            log.actions[step], log.log_probabilities[step], self.key = drawn
            self._last_obs, rewards, dones, infos = env.step(log.actions[step])
            self.num_timesteps += env.num_envs
            if not callback.on_step():
                return False
            log.note(step, rewards, dones, infos)
            self._note_returns(log.rewards[step], dones)
        log.observations[-1] = self._last_obs
        self._rollout = self._rollout_of(log)
        return True

    def train(self) -> None:
        """Update the networks on the rollout, then the normalisation by it."""
        rollout = self._rollout
        assert rollout is not None
        states: list[Any] = [self.policy.actor_state, self.policy.vf_state]
        self._update_learning_rate(
            [state.opt_state[1] for state in states],  # as SBX chains its optimisers
            self.lr_schedule(self._current_progress_remaining),
        )
        self.policy.actor_state, self.policy.vf_state, self.key = self._update_compiled(
            self.policy.actor_state, self.policy.vf_state, self.normalisation, rollout, self.key
        )
        self._n_updates += self.n_epochs
        self._normal.update(rollout.observations.astype(np.float64))

    def _note_returns(self, rewards: np.ndarray, dones: np.ndarray) -> None:
        self._return = self._return * self.gamma + rewards
        self._discounted.update(self._return)
        self._return[dones] = 0.0

    def _rollout_of(self, log: "_Log") -> Rollout:
        log.rewards /= np.sqrt(self._discounted.var + _SMALL)
        self._continue(log.rewards, log.cut)
        values = self._values(log.observations)
        advantages = _advantages(log.rewards, values, log.dones, self.gamma, self.gae_lambda)
        returns = advantages + values[:-1]
        parts = (log.observations[:-1], log.actions, advantages, returns, log.log_probabilities)
        return Rollout(*(part.reshape(-1, *part.shape[2:]) for part in parts))

    def _continue(self, rewards: np.ndarray, cut: list["_Cut"]) -> None:
        """Add the value of the state in which the time limit cut an episode to its last reward."""
        if not cut:
            return
        # in multiples of the environments: another number of rows would be compiled anew
        last = np.zeros((self.n_envs * -(-len(cut) // self.n_envs), len(cut[0][2])), np.float32)
        last[: len(cut)] = [observation for *_, observation in cut]
        for (step, i, _), value in zip(cut, self._values(last), strict=False):
            rewards[step, i] += self.gamma * value

    def _values(self, observations: np.ndarray) -> np.ndarray:
        """The critic's values of observations (…, s), (…,)."""
        return np.asarray(
            self._value_compiled(self.policy.vf_state, self.normalisation, observations)
        )

    def _compile(self) -> Callable[..., tuple[Any, Any, jax.Array]]:
        epochs, size = self.n_epochs, self.batch_size
        options = (self.clip_range, self.ent_coef, self.vf_coef, self.normalize_advantage)

        @jax.jit
        def update(
            actor: Any, critic: Any, normal: Any, rollout: Rollout, key: jax.Array
        ) -> tuple[Any, Any, jax.Array]:
            seen = rollout._replace(observations=_normalised(normal, rollout.observations))
            count = len(seen.advantages)

            def minibatch(states: Any, rows: jax.Array) -> Any:
                part = (column[rows] for column in seen)
                return self._one_update(*states, *part, *options)[0], None

            def epoch(states: Any, key: jax.Array) -> Any:
                order = jax.random.permutation(key, count)
                return jax.lax.scan(minibatch, states, order.reshape(-1, size))

            key, *keys = jax.random.split(key, epochs + 1)
            (actor, critic), _ = jax.lax.scan(epoch, (actor, critic), jnp.stack(keys))
            return actor, critic, key

        return update


def _normalised(normal: tuple[Any, Any], observations: Any) -> Any:
    mean, scale = normal
    return (observations - mean) * scale


def _act(actor: Any, normal: Any, observations: jax.Array, key: jax.Array) -> Any:
    """Actions, their log probabilities, and the next key."""
    key, noise = jax.random.split(key)
    distribution = actor.apply_fn(actor.params, _normalised(normal, observations))
    actions = distribution.sample(seed=noise)
    return actions, distribution.log_prob(actions), key


def _value(critic: Any, normal: Any, observations: jax.Array) -> jax.Array:
    flat = _normalised(normal, observations).reshape(-1, observations.shape[-1])
    return critic.apply_fn(critic.params, flat).reshape(observations.shape[:-1])


def _advantages(
    rewards: np.ndarray, values: np.ndarray, dones: np.ndarray, gamma: float, gae_lambda: float
) -> np.ndarray:
    """Generalised advantage estimates (Schulman et al., arXiv 1506.02438, Eq. 16), (t, n)."""
    advantages = np.empty_like(rewards)
    following = np.zeros(rewards.shape[1], np.float32)
    for step in reversed(range(len(rewards))):
        alive = 1 - dones[step].astype(np.float32)
        error = rewards[step] + gamma * alive * values[step + 1] - values[step]
        following = error + gamma * gae_lambda * alive * following
        advantages[step] = following
    return advantages

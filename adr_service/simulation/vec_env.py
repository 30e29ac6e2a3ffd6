"""The training environment: an SB3 `VecEnv` over the batch, new dynamics each episode."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from adr_service.arrays import Indices, Matrix, Vector
from adr_service.distributions import Draws
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import check_rewards
from adr_service.tasks.base import Source, State, Task

# called with rows (k,), dynamics (k, d), returns (k,) and the steps of all environments so far
Ended = Callable[[Indices, Matrix, Vector, int], None]


class Sampler(Protocol):
    """Something that draws dynamics: a distribution, or one that moves."""

    def sample(self, n: int, rng: np.random.Generator) -> Draws: ...


class RandomizedVecEnv(VecEnv):
    """n environments stepped by one C++ call; dynamics ~ `distribution` at episode start.

    `adjusted` counts the draws that were moved onto a bound of the space. `diverged` counts the
    episodes whose simulation diverged: their last observation is zeros and earns nothing.
    `ended` is called when episodes end, before the next ones draw their dynamics.
    """

    render_mode = None

    def __init__(
        self,
        task: Task,
        source: Source,
        distribution: Sampler,
        n: int,
        rng: np.random.Generator,
        threads: int = 1,
        ended: Ended | None = None,
    ):
        space = gymnasium.spaces
        super().__init__(
            n,
            space.Box(-np.inf, np.inf, (len(task.columns),), np.float32),
            space.Box(task.action_low.astype(np.float32), task.action_high.astype(np.float32)),
        )
        self._task, self._distribution, self._rng = task, distribution, rng
        self._ended = ended
        self._before = State(np.empty((0, 0)), np.empty((0, 0)))  # until the first reset
        self.simulations = Simulations(task, source, n, threads)
        self._steps = np.zeros(n, dtype=np.int64)  # of the episode in each environment
        self._returns = np.zeros(n)  # of the same
        self._taken = 0  # steps of all environments
        self.adjusted = 0
        self.diverged = 0
        self._actions = np.zeros((n, len(task.action_low)))

    @property
    def dynamics(self) -> Matrix:
        """The dynamics of each environment's episode, (n, d) in SI units."""
        return self.simulations.dynamics.copy()

    def reset(self) -> np.ndarray:
        return self._begin(np.arange(self.num_envs))

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = np.asarray(actions, dtype=np.float64)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        task, simulations = self._task, self.simulations
        simulations.step(self._actions)
        after = simulations.state
        rewards = task.reward(self._before, self._actions, after)
        self._steps += 1
        broken = simulations.diverged
        self.diverged += int(np.count_nonzero(broken))
        terminated = task.terminated(after) | broken
        done = terminated | (self._steps >= task.horizon)
        observations = task.observe(after).astype(np.float32)
        if broken.any():
            observations[broken], rewards[broken] = 0.0, 0.0
        check_rewards(task, rewards)
        self._returns += rewards
        self._taken += self.num_envs
        self._before = after
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            rows = np.flatnonzero(done)
            for row in rows:
                infos[row] = {
                    "terminal_observation": observations[row].copy(),
                    "TimeLimit.truncated": not terminated[row],
                }
            if self._ended is not None:
                self._ended(rows, self.dynamics[rows], self._returns[rows], self._taken)
            observations[rows] = self._begin(rows)[rows]
        return observations, rewards, done, infos

    def _begin(self, rows: Indices) -> np.ndarray:
        """Start episodes in `rows` under new draws of dynamics; returns all observations."""
        draws = self._distribution.sample(len(rows), self._rng)
        self.adjusted += draws.adjusted
        self.simulations.set_dynamics(draws.values, rows)
        fresh: State = self._task.initial(len(rows), self._rng)
        self.simulations.set_state(fresh, rows)
        self._steps[rows], self._returns[rows] = 0, 0.0
        self._before = self.simulations.state
        return self._task.observe(self._before).astype(np.float32)

    def close(self) -> None:
        """Release nothing: all memory is this process's own."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise AttributeError(f"environments of a batch have no attribute {attr_name!r} to set")

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        raise AttributeError(f"environments of a batch have no method {method_name!r}")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [False] * len(self._chosen(indices))

    def _chosen(self, indices: Any) -> Sequence[int]:
        return list(self._get_indices(indices))

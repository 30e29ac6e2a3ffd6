"""Soft Actor-Critic on randomised dynamics, by Stable-Baselines3 or its JAX twin SBX.

    trained = train(task, source, distribution, settings, rng)
    trained.policy.act(observations)

Training stops when the mean return over evaluation episodes, drawn from the *source*
distribution, reaches the task's reward threshold. The result is the best policy of all
evaluations. Both backends take the same hyperparameters and give the same kind of `Policy`. A
process trains one policy at a time, because SB3's replay buffer draws from NumPy's global
generator, which it seeds from our stream.
"""

import importlib.util
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from adr_service.distributions import Distribution
from adr_service.errors import InvalidInput
from adr_service.progress import Checkpoint, Progress, silent
from adr_service.randomness import integer_seed
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import run_episodes
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.startup_time import add_preparation, preparing
from adr_service.tasks.base import Source, Task
from adr_service.training.curve import Evaluation
from adr_service.training.policy import Layer, Policy
from adr_service.training.settings import TrainingSettings

# the checkpoint that keeps the best policy so far, after a learning curve
Keep = Callable[[Policy, Sequence[Evaluation]], Checkpoint]


@dataclass(frozen=True)
class Training:
    """A trained policy with its learning curve and its costs."""

    policy: Policy  # the best of all evaluations
    curve: tuple[Evaluation, ...]
    steps: int
    adjusted_draws: int  # dynamics moved onto a bound, see `Draws`
    diverged_episodes: int  # ended because the simulation diverged

    @property
    def best(self) -> Evaluation:
        return max(self.curve, key=lambda point: point.mean_return)


def train(
    task: Task,
    source: Source,
    distribution: Distribution,
    settings: TrainingSettings,
    rng: np.random.Generator,
    progress: Progress = silent,
    keep: Keep | None = None,
) -> Training:
    """Train a policy for `distribution` on the task's source.

    After every evaluation, progress is reported with the checkpoint that `keep` makes.
    """
    dynamics_rng, evaluation_rng, seed_rng = rng.spawn(3)
    env = RandomizedVecEnv(task, source, distribution, settings.environments, dynamics_rng)
    assert settings.backend is not None, "validation has chosen one"
    backend = BACKENDS[settings.backend]
    model = backend.build(env, settings, _hyperparameters(task, settings, integer_seed(seed_rng)))
    stop_at = task.reward_threshold if settings.stop_at_threshold else math.inf
    judge = _Judge(task, source, distribution, settings, evaluation_rng)
    monitor = _Monitor(backend, judge, settings, stop_at, progress, keep)
    model.set_logger(Logger(None, []))  # SB3's own makes a folder per training
    model.learn(settings.max_steps, callback=monitor, log_interval=None)
    if not judge.curve or judge.curve[-1].steps < model.num_timesteps:
        judge.evaluate(backend.policy(model, task, settings.activation), model.num_timesteps)
    assert judge.best is not None
    return Training(judge.best, tuple(judge.curve), model.num_timesteps, env.adjusted, env.diverged)


class _Judge:
    """Evaluates policies on new draws of the source distribution and keeps the best."""

    def __init__(
        self,
        task: Task,
        source: Source,
        distribution: Distribution,
        settings: TrainingSettings,
        rng: np.random.Generator,
    ):
        self.task, self._distribution, self._rng = task, distribution, rng
        self._simulations = Simulations(task, source, settings.evaluation_episodes)
        self.curve: list[Evaluation] = []
        self.best: Policy | None = None

    def evaluate(self, policy: Policy, steps: int) -> Evaluation:
        n = self._simulations.n
        self._simulations.set_dynamics(self._distribution.sample(n, self._rng).values)
        initial = self.task.initial(n, self._rng)
        episodes = run_episodes(
            self.task, self._simulations, policy.act, initial, self.task.horizon
        )
        error = float(np.std(episodes.returns, ddof=1) / np.sqrt(n)) if n > 1 else 0.0
        mean_return = float(np.mean(episodes.returns))
        point = Evaluation(steps=steps, mean_return=mean_return, standard_error=error)
        if self.best is None or point.mean_return > max(p.mean_return for p in self.curve):
            self.best = policy
        self.curve.append(point)
        return point


class _Monitor(BaseCallback):
    """Evaluates on schedule, reports progress and stops at the threshold."""

    def __init__(
        self,
        backend: "_Backend",
        judge: _Judge,
        settings: TrainingSettings,
        stop_at: float,
        progress: Progress,
        keep: Keep | None,
    ):
        super().__init__()
        self._backend, self._judge, self._settings = backend, judge, settings
        self._stop_at, self._progress, self._keep = stop_at, progress, keep

    def _on_step(self) -> bool:
        judge, done = self._judge, self.num_timesteps
        if done // self._settings.evaluate_every == len(judge.curve):
            self._report(None)
            return True
        policy = self._backend.policy(self.model, judge.task, self._settings.activation)
        point = judge.evaluate(policy, done)
        assert judge.best is not None
        self._report(None if self._keep is None else self._keep(judge.best, judge.curve))
        return point.mean_return < self._stop_at

    def _report(self, checkpoint: Checkpoint | None) -> None:
        done, curve = self.num_timesteps, self._judge.curve
        latest = curve[-1].mean_return if curve else None
        fraction = done / self._settings.max_steps
        self._progress(fraction, checkpoint=checkpoint, steps=done, source_return=latest)


class _Backend(Protocol):
    """A library that implements SAC with the SB3 interface."""

    def build(self, env: RandomizedVecEnv, settings: TrainingSettings, common: Any) -> Any: ...
    def policy(self, model: Any, task: Task, activation: str) -> Policy: ...


def _hyperparameters(task: Task, settings: TrainingSettings, seed: int) -> dict[str, Any]:
    return {
        "learning_rate": settings.learning_rate or task.learning_rate,
        # no larger than a training can fill, because allocating takes time
        "buffer_size": min(settings.buffer_size, settings.max_steps + settings.environments),
        "learning_starts": settings.learning_starts,
        "batch_size": settings.batch_size,
        "tau": settings.tau,
        "gamma": settings.gamma,
        "train_freq": 1,
        "gradient_steps": settings.gradient_steps,
        "seed": seed,
    }


class _Sb3:
    """Stable-Baselines3 (PyTorch): the reference."""

    def build(self, env: RandomizedVecEnv, settings: TrainingSettings, common: Any) -> Any:
        with preparing():
            import stable_baselines3
            import torch

        torch.set_num_threads(1)
        functions = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh}
        kwargs = {"net_arch": settings.hidden, "activation_fn": functions[settings.activation]}
        return stable_baselines3.SAC("MlpPolicy", env, policy_kwargs=kwargs, device="cpu", **common)

    def policy(self, model: Any, task: Task, activation: str) -> Policy:
        import torch

        actor = model.policy.actor
        linear = [m for m in actor.latent_pi if isinstance(m, torch.nn.Linear)] + [actor.mu]
        layers = tuple(
            (m.weight.detach().numpy().copy(), m.bias.detach().numpy().copy()) for m in linear
        )
        return _actor(task, activation, layers)


class _Sbx:
    """SBX (JAX), by the authors of SB3: the same interface with more updates per second."""

    def build(self, env: RandomizedVecEnv, settings: TrainingSettings, common: Any) -> Any:
        if importlib.util.find_spec("sbx") is None:
            raise InvalidInput(
                "backend 'sbx' needs the package sbx-rl (pip install sbx-rl); without it, use 'sb3'"
            )
        with preparing():
            import flax.linen

            from adr_service.training.fused_sac import FusedSac

        _count_compilations()
        functions = {"relu": flax.linen.relu, "tanh": flax.linen.tanh}
        kwargs = {"net_arch": settings.hidden, "activation_fn": functions[settings.activation]}
        return FusedSac("MlpPolicy", env, policy_kwargs=kwargs, **common)

    def policy(self, model: Any, task: Task, activation: str) -> Policy:
        model.publish()
        dense = model.policy.actor_state.params["params"]
        # Dense_0 .. Dense_{k-1} hidden, Dense_k the mean, Dense_{k+1} the log deviation
        layers = tuple(
            (
                np.array(dense[f"Dense_{i}"]["kernel"]).T.copy(),
                np.array(dense[f"Dense_{i}"]["bias"]),
            )
            for i in range(len(dense) - 1)
        )
        return _actor(task, activation, layers)


@cache
def _count_compilations() -> None:
    """Count the time that JAX spends on compiling as preparation, once per process."""
    import jax

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith("/jax/core/compile/") and "trace" not in event:  # traces are nested
            add_preparation(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)


def _actor(task: Task, activation: str, layers: tuple[Layer, ...]) -> Policy:
    if not all(np.isfinite(weight).all() and np.isfinite(bias).all() for weight, bias in layers):
        raise InvalidInput("training diverged: the actor's weights are not finite")
    return Policy(layers, activation, task.action_low, task.action_high)


BACKENDS: Mapping[str, _Backend] = {"sbx": _Sbx(), "sb3": _Sb3()}

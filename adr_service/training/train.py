"""Training a policy on randomised dynamics.

    trained = train(task, source, distribution, settings, rng)
    trained.policy.act(observations)

Training stops when the policy earns the task's reward threshold on average over episodes drawn
from the *source* distribution. The result is the best policy of all evaluations. Every algorithm
has two backends, Stable-Baselines3 (PyTorch) and its authors' JAX twin SBX, which take the same
hyperparameters and give the same kind of `Policy`. A process trains one policy at a time, because
SB3 draws from NumPy's global generator, which it seeds from our stream.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from adr_service.distributions import Distribution
from adr_service.progress import Checkpoint, Progress, silent
from adr_service.randomness import integer_seed
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.base import Source, Task
from adr_service.training import crossq, ppo, sac
from adr_service.training.average import Average
from adr_service.training.curve import Evaluation
from adr_service.training.judge import Judge
from adr_service.training.libraries import Library
from adr_service.training.networks import Networks
from adr_service.training.policy import Policy
from adr_service.training.settings import TrainingSettings

LIBRARIES: Mapping[str, Mapping[str, Library]] = {  # by algorithm and backend
    "sac": sac.LIBRARIES,
    "crossq": crossq.LIBRARIES,
    "ppo": ppo.LIBRARIES,
}
# the checkpoint that keeps the best policy so far, after a learning curve
Keep = Callable[[Policy, Sequence[Evaluation]], Checkpoint]


@dataclass(frozen=True)
class Training:
    """A trained policy with its learning curve and its costs."""

    policy: Policy  # the best of all evaluations
    best: Evaluation  # of the policy
    reached_threshold: bool
    curve: tuple[Evaluation, ...]
    steps: int  # of the environments, also of networks that lost a race
    adjusted_draws: int  # dynamics moved onto a bound, see `Draws`
    diverged_episodes: int  # ended because the simulation diverged
    networks: Networks  # of the last step, from which another training may start


def train(
    task: Task,
    source: Source,
    distribution: Distribution,
    settings: TrainingSettings,
    rng: np.random.Generator,
    progress: Progress = silent,
    keep: Keep | None = None,
    start: Networks | None = None,
) -> Training:
    """Train a policy for `distribution` on the task's source.

    After every evaluation, progress is reported with the checkpoint that `keep` makes. `start` has
    the networks of an earlier training with the same settings.
    """
    dynamics_rng, evaluation_rng, seed_rng = rng.spawn(3)
    assert settings.backend is not None, "validation has chosen one"
    library = LIBRARIES[settings.algorithm][settings.backend]
    environments: list[RandomizedVecEnv] = []

    def build(rng: np.random.Generator) -> Any:
        env = RandomizedVecEnv(task, source, distribution, settings.environments, rng)
        environments.append(env)
        model = library.build(env, task, settings, integer_seed(seed_rng))
        model.set_logger(Logger(None, []))  # SB3's own makes a folder per training
        return model

    judge = Judge(task, source, distribution, settings, evaluation_rng)
    monitor = _Monitor(library, judge, settings, progress, keep)
    if settings.race is None:
        model = build(dynamics_rng)
    else:
        rngs = dynamics_rng.spawn(settings.race.candidates)
        model = monitor.winner(map(build, rngs), settings.race.steps)
    if start is not None:
        library.start(model, start)
    _learn(model, settings, monitor)
    if not judge.curve or monitor.steps > judge.curve[-1].steps:
        monitor.evaluate()
    return Training(
        policy=judge.policy,
        best=judge.reported(),
        reached_threshold=judge.has_reached(task.reward_threshold),
        curve=tuple(judge.curve),
        steps=monitor.steps,
        adjusted_draws=sum(env.adjusted for env in environments),
        diverged_episodes=sum(env.diverged for env in environments),
        networks=library.networks(model),
    )


def _learn(model: Any, settings: TrainingSettings, callback: BaseCallback) -> None:
    """Train until the callback or the last step ends it; also on from where it was ended before."""
    left = settings.steps - model.num_timesteps
    model.learn(left, callback=callback, log_interval=None, reset_num_timesteps=False)


class _Monitor(BaseCallback):
    """Evaluates on schedule, reports progress and stops at the threshold."""

    def __init__(
        self,
        library: Library,
        judge: Judge,
        settings: TrainingSettings,
        progress: Progress,
        keep: Keep | None,
    ):
        super().__init__()
        self._library, self._judge, self._settings = library, judge, settings
        self._progress, self._keep = progress, keep
        self._average = Average(settings.averaged_steps) if settings.averaged_steps else None
        threshold = judge.task.reward_threshold
        self._stop_at = threshold if settings.stop_at_threshold else math.inf
        self._intervals = 0  # of evaluations, which have passed
        self._lost = 0  # steps of the networks that lost the race

    @property
    def steps(self) -> int:
        """Environment steps of all networks so far."""
        return self._lost + self.num_timesteps

    def winner(self, candidates: Iterable[Any], steps: int) -> Any:
        """Train each model for so many steps; gives the one with the best evaluation."""
        judge, best, most = self._judge, None, -math.inf
        for model in candidates:
            _learn(model, self._settings, _Race(steps, self._report))
            policy = self._library.policy(model, judge.task, self._settings)
            earned = judge.measured(policy, model.num_timesteps).mean_return
            self._lost += model.num_timesteps
            if earned > most:
                best, most = model, earned
        assert best is not None, "a race has candidates"
        self._lost -= best.num_timesteps
        return best

    def _on_step(self) -> bool:
        judge, done = self._judge, self.num_timesteps
        if self._average is not None and self._average.is_due(done):
            self._average.add(self._latest(), done)
        intervals = done // self._settings.evaluate_every
        if intervals == self._intervals:
            self._report(done)
            return True
        self._intervals = intervals
        self.evaluate()
        self._report(done, None if self._keep is None else self._keep(judge.policy, judge.curve))
        return not judge.has_reached(self._stop_at)

    def evaluate(self) -> None:
        """Evaluate the present policy: the averaged one, where the settings ask for it."""
        policy = self._latest()
        if self._average is not None:
            policy = self._average.add(policy, self.num_timesteps)
        self._judge.evaluate(policy, self.steps)

    def _latest(self) -> Policy:
        return self._library.policy(self.model, self._judge.task, self._settings)

    def _report(self, own: int, checkpoint: Checkpoint | None = None) -> None:
        """Report progress after so many steps of the present network."""
        done, curve = self._lost + own, self._judge.curve
        latest = curve[-1].mean_return if curve else None
        fraction = done / (self._settings.steps + self._settings.lost_steps)
        self._progress(fraction, checkpoint=checkpoint, steps=done, source_return=latest)


class _Race(BaseCallback):
    """Ends a candidate's training at the first step after its last one, and reports progress.

    So PPO has learned from the rollout that ends with the last step.
    """

    def __init__(self, steps: int, report: Callable[[int], None]):
        super().__init__()
        self._steps, self._report = steps, report

    def _on_step(self) -> bool:
        self._report(self.num_timesteps)
        return self.num_timesteps <= self._steps

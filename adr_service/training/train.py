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
    lost = 0
    if settings.race is None:
        model = build(dynamics_rng)
    else:
        candidates = map(build, dynamics_rng.spawn(settings.race.candidates))
        model, lost = _winner(candidates, library, judge, settings, progress)
    if start is not None:
        library.start(model, start)
    monitor = _Monitor(library, judge, settings, progress, keep, lost)
    _learn(model, settings, settings.steps - model.num_timesteps, monitor)
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


def _learn(model: Any, settings: TrainingSettings, steps: int, callback: BaseCallback) -> None:
    """Train for so many more steps. A learning rate that falls does so over the whole training."""
    schedule = model.lr_schedule
    part = (model.num_timesteps + steps) / settings.steps  # of the training, after these steps
    model.lr_schedule = lambda remaining: schedule(1 - part * (1 - remaining))
    model.learn(steps, callback=callback, log_interval=None, reset_num_timesteps=False)
    model.lr_schedule = schedule


def _winner(
    candidates: Iterable[Any],
    library: Library,
    judge: Judge,
    settings: TrainingSettings,
    progress: Progress,
) -> tuple[Any, int]:
    """The candidate with the best evaluation after the race, and the steps of the others."""
    assert settings.race is not None
    best, most, total = None, -math.inf, 0
    for model in candidates:
        _learn(model, settings, settings.race.steps, _Candidate(settings, progress, total))
        point = judge.measure(library.policy(model, judge.task, settings), model.num_timesteps)
        total += model.num_timesteps
        if point.mean_return > most:
            best, most = model, point.mean_return
    assert best is not None, "a race has candidates"
    return best, total - best.num_timesteps


class _Reporter(BaseCallback):
    """Reports progress; other networks have taken `before` steps."""

    def __init__(self, settings: TrainingSettings, progress: Progress, before: int):
        super().__init__()
        self._settings, self._progress, self._before = settings, progress, before

    @property
    def steps(self) -> int:
        """Environment steps of all networks so far."""
        return self._before + self.num_timesteps

    def _report(self, checkpoint: Checkpoint | None, source_return: float | None) -> None:
        fraction = self.steps / self._settings.all_steps
        self._progress(
            fraction, checkpoint=checkpoint, steps=self.steps, source_return=source_return
        )


class _Candidate(_Reporter):
    """Reports progress of a race."""

    def _on_step(self) -> bool:
        self._report(None, None)
        return True


class _Monitor(_Reporter):
    """Evaluates on schedule, reports progress and stops at the threshold."""

    def __init__(
        self,
        library: Library,
        judge: Judge,
        settings: TrainingSettings,
        progress: Progress,
        keep: Keep | None,
        lost: int,
    ):
        super().__init__(settings, progress, lost)
        self._library, self._judge, self._keep = library, judge, keep
        self._average = Average(settings.averaged_steps) if settings.averaged_steps else None
        threshold = judge.task.reward_threshold
        self._stop_at = threshold if settings.stop_at_threshold else math.inf
        self._intervals = 0  # between evaluations, that have passed

    def _on_training_start(self) -> None:
        self._intervals = self.num_timesteps // self._settings.evaluate_every

    def _on_step(self) -> bool:
        judge, done = self._judge, self.num_timesteps
        if self._average is not None and self._average.is_due(done):
            self._average.add(self._latest(), done)
        intervals = done // self._settings.evaluate_every
        if intervals == self._intervals:
            self._report(None, judge.curve[-1].mean_return if judge.curve else None)
            return True
        self._intervals = intervals
        point = self.evaluate()
        kept = None if self._keep is None else self._keep(judge.policy, judge.curve)
        self._report(kept, point.mean_return)
        return not judge.has_reached(self._stop_at)

    def evaluate(self) -> Evaluation:
        """Evaluate the present policy: the averaged one, where the settings ask for it."""
        policy = self._latest()
        if self._average is not None:
            policy = self._average.add(policy, self.num_timesteps)
        return self._judge.evaluate(policy, self.steps)

    def _latest(self) -> Policy:
        return self._library.policy(self.model, self._judge.task, self._settings)

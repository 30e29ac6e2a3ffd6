"""Training a policy on randomised dynamics.

    trained = train(task, source, distribution, settings, rng)
    trained.policy.act(observations)

Training stops when the policy earns the task's reward threshold on average over episodes drawn
from the *source* distribution. The result is the best policy by the judge's rule. Every algorithm
has two backends, Stable-Baselines3 (PyTorch) and its authors' JAX twin SBX, which take the same
hyperparameters and give the same kind of `Policy`. A process trains one policy at a time, because
SB3 draws from NumPy's global generator, which it seeds from our stream.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from adr_service.distributions import Distribution, check_space
from adr_service.progress import Checkpoint, Progress, StageCancelled, silent
from adr_service.randomness import integer_seed
from adr_service.simulation.vec_env import RandomizedVecEnv
from adr_service.tasks.base import Source, Task
from adr_service.training import crossq, ppo, sac
from adr_service.training.average import Average
from adr_service.training.curriculum import Course, Curriculum, Phase
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
    steps: int
    adjusted_draws: int  # dynamics moved onto a bound, see `Draws`
    diverged_episodes: int  # ended because the simulation diverged
    networks: Networks  # of the last step, from which another training may start
    phases: tuple[Phase, ...] = ()  # of the curriculum


def train(
    task: Task,
    source: Source,
    distribution: Distribution,
    settings: TrainingSettings,
    rng: np.random.Generator,
    *,
    progress: Progress = silent,
    keep: Keep | None = None,
    start: Networks | None = None,
    curriculum: Curriculum | None = None,
) -> Training:
    """Train a policy for `distribution` on the task's source.

    After every evaluation, progress is reported with the checkpoint that `keep` makes. `start` has
    the networks of an earlier training with the same settings. With a curriculum, the episodes of
    the training are drawn from that, and those of the evaluations from `distribution`.
    """
    check_space("the distribution to train on", distribution, source.space)
    dynamics_rng, evaluation_rng, seed_rng = rng.spawn(3)
    n = settings.environments
    course = None if curriculum is None else Course(curriculum, source.space, n)
    drawn, ended = (distribution, None) if course is None else (course, course.ended)
    env = RandomizedVecEnv(task, source, drawn, n, dynamics_rng, ended=ended)
    assert settings.backend is not None, "validation has chosen one"
    library = LIBRARIES[settings.algorithm][settings.backend]
    model = library.build(env, task, settings, integer_seed(seed_rng))
    if start is not None:
        library.load(model, start)
    judge = Judge(task, source, distribution, settings, evaluation_rng)
    monitor = _Monitor(library, judge, settings, progress, keep)
    model.set_logger(Logger(None, []))  # SB3's own makes a folder per training
    try:
        model.learn(settings.steps, callback=monitor, log_interval=None)
    except StageCancelled:
        raise
    except Exception:
        library.policy(model, task, settings)  # raises its own error where weights are not finite
        raise
    if not judge.curve or judge.curve[-1].steps < model.num_timesteps:
        monitor.evaluate()
    return Training(
        policy=judge.policy,
        best=judge.reported(),
        reached_threshold=judge.has_reached(task.reward_threshold),
        curve=tuple(judge.curve),
        steps=model.num_timesteps,
        adjusted_draws=env.adjusted,
        diverged_episodes=env.diverged,
        networks=library.networks(model),
        phases=() if course is None else tuple(course.phases),
    )


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
        self._average = (
            Average(settings.averaged_steps, at_least_every=settings.evaluate_every)
            if settings.averaged_steps
            else None
        )
        threshold = judge.task.reward_threshold
        self._stop_at = threshold if settings.stop_at_threshold else math.inf

    def _on_step(self) -> bool:
        judge, done = self._judge, self.num_timesteps
        if self._average is not None and self._average.is_due(done):
            self._average.add(self._latest(), done)
        if done // self._settings.evaluate_every == len(judge.curve):
            self._report(None)
            return True
        self.evaluate()
        self._report(None if self._keep is None else self._keep(judge.policy, judge.curve))
        return not judge.has_reached(self._stop_at)

    def evaluate(self) -> None:
        """Evaluate the present policy: the averaged one, where the settings ask for it."""
        policy, done = self._latest(), self.num_timesteps
        if self._average is not None:
            policy = self._average.add(policy, done)
        self._judge.evaluate(policy, done)

    def _latest(self) -> Policy:
        return self._library.policy(self.model, self._judge.task, self._settings)

    def _report(self, checkpoint: Checkpoint | None) -> None:
        done, curve = self.num_timesteps, self._judge.curve
        latest = curve[-1].mean_return if curve else None
        fraction = min(done / self._settings.steps, 1.0)  # all environments take the last step
        self._progress(fraction, checkpoint=checkpoint, steps=done, source_return=latest)

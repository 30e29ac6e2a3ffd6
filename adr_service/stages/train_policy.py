"""Train one policy on one distribution of simulator parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adr_service.distributions import Distribution
from adr_service.events import RunEvent, TrainingEvaluated
from adr_service.progress import Checkpoint, Progress
from adr_service.stages.base import CoreSpeed, Cost, Result, Role, Stage
from adr_service.startup_time import preparing
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.curve import Evaluation
from adr_service.training.policy import Policy
from adr_service.training.settings import TrainingSettings

# Seconds of one gradient step on one server core, measured in trainings of `hopper` and of the
# demo (docs/training.md): a part that does not shrink with the networks, and one in proportion to
# them, for 2x128 and batches of 256
_UPDATE_S = {"sbx": (0.00005, 0.0030), "sb3": (0.0025, 0.0125)}
_REFERENCE_WORK = 256 * 128**2  # batch size x weights between the hidden layers
_VECTOR_STEP_S = 0.0007  # acting and storing, per step of all environments


class TrainedPolicy(Result):
    """A policy and its learning curve."""

    policy: bytes  # of the best evaluation
    steps: int  # of the environments
    source_return: float  # of the best evaluation, so a little high
    reached_threshold: bool
    curve: list[Evaluation]
    adjusted_draws: int  # dynamics moved onto a bound of the space
    diverged_episodes: int


@dataclass(frozen=True, kw_only=True)
class TrainPolicy(Stage[TrainedPolicy]):
    """Training on a task's source, until its reward threshold or the last step."""

    kind: ClassVar = "train_policy"
    version: ClassVar = 3
    role: ClassVar[Role] = "trainer"
    result: ClassVar = TrainedPolicy

    variant: str  # a domain; the field's name is part of the digest
    seed: int
    distribution: Distribution
    training: TrainingSettings

    def compute(self, rng: np.random.Generator, progress: Progress) -> TrainedPolicy:
        # importing PyTorch and JAX takes seconds: only trainers pay
        with preparing():
            from adr_service.training.sac import train

        task = get_task(self.task)
        source = source_of(self.task, self.variant)
        training = train(
            task, source, self.distribution, self.training, rng, progress, self._checkpoint
        )
        best = training.best.mean_return
        return TrainedPolicy(
            policy=training.policy.to_bytes(),
            steps=training.steps,
            source_return=best,
            reached_threshold=best >= task.reward_threshold,
            curve=list(training.curve),
            adjusted_draws=training.adjusted_draws,
            diverged_episodes=training.diverged_episodes,
        )

    def events(self, result: TrainedPolicy) -> list[RunEvent]:
        return self._evaluated(result.curve)

    def cost(self, speed: CoreSpeed) -> Cost:
        settings, task = self.training, get_task(self.task)
        assert settings.backend is not None, "validation has chosen one"
        fixed, proportional = _UPDATE_S[settings.backend]
        work = settings.batch_size * float(np.prod(settings.hidden[:2])) / _REFERENCE_WORK
        update = fixed + proportional * work
        rounds = settings.max_steps / settings.environments
        evaluations = -(-settings.max_steps // settings.evaluate_every)
        simulated = settings.max_steps + evaluations * settings.evaluation_episodes * task.horizon
        updating = rounds * (settings.gradient_steps * update + _VECTOR_STEP_S)
        return Cost(
            seconds=simulated / speed.steps_per_second(self.task) + updating,
            environment_steps=settings.max_steps,
            policy_bytes=settings.policy_bytes(len(task.columns), len(task.action_low)),
        )

    def stand_in(self) -> TrainedPolicy:
        return TrainedPolicy(
            policy=f"policy of {self.digest}".encode(),
            steps=self.training.max_steps,
            source_return=0.0,
            reached_threshold=False,
            curve=[],
            adjusted_draws=0,
            diverged_episodes=0,
        )

    def _checkpoint(self, policy: Policy, curve: Sequence[Evaluation]) -> Checkpoint:
        return Checkpoint(curve[-1].steps, policy.to_bytes(), tuple(self._evaluated(curve)))

    def _evaluated(self, curve: Sequence[Evaluation]) -> list[RunEvent]:
        return [TrainingEvaluated(digest=self.digest, **point.model_dump()) for point in curve]

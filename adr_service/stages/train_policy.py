"""Train one policy on one distribution of simulator parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adr_service.distributions import Distribution
from adr_service.events import RunEvent, TrainingEvaluated
from adr_service.methods.base import CurriculumSettings, Problem
from adr_service.progress import Checkpoint, Progress
from adr_service.stages.base import CoreSpeed, Cost, Result, Role, Stage
from adr_service.startup_time import preparing
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.curriculum import Phase
from adr_service.training.curve import Evaluation
from adr_service.training.policy import Policy
from adr_service.training.settings import TrainingSettings


class TrainedPolicy(Result):
    """A policy and its learning curve."""

    policy: bytes  # of the best evaluation
    steps: int  # of the environments
    source_return: float  # of the confirmation, else of the best evaluation, so a little high
    reached_threshold: bool
    curve: list[Evaluation]
    adjusted_draws: int  # dynamics moved onto a bound of the space
    diverged_episodes: int
    confirmation: Evaluation | None = None  # of the policy, on fresh draws
    networks: bytes | None = None  # where the next training starts from them
    phases: list[Phase] | None = None  # of a curriculum


@dataclass(frozen=True, kw_only=True)
class TrainPolicy(Stage[TrainedPolicy]):
    """Training on a task's source, until its reward threshold or the last step.

    With a curriculum, the policy is judged on `distribution`, and trained on the curriculum's.
    """

    kind: ClassVar = "train_policy"
    version: ClassVar = 3
    role: ClassVar[Role] = "trainer"
    result: ClassVar = TrainedPolicy

    variant: str  # a domain; the field's name is part of the digest
    seed: int
    distribution: Distribution
    training: TrainingSettings
    start: bytes | None = None  # networks of the policy before; None: new ones
    repeat: int | None = None  # number of an independent repetition
    curriculum: CurriculumSettings | None = None
    curriculum_package: str | None = None

    def compute(self, rng: np.random.Generator, progress: Progress) -> TrainedPolicy:
        # importing PyTorch and JAX takes seconds: only trainers pay
        with preparing():
            from adr_service.training import networks
            from adr_service.training.train import train

        task = get_task(self.task)
        source = source_of(self.task, self.variant)
        training = train(
            task,
            source,
            self.distribution,
            self.training,
            rng,
            progress=progress,
            keep=self._checkpoint,
            start=None if self.start is None else networks.from_bytes(self.start),
            curriculum=(
                None if self.curriculum is None else self.curriculum.create(Problem(task, source))
            ),
        )
        return TrainedPolicy(
            policy=training.policy.to_bytes(),
            steps=training.steps,
            source_return=training.best.mean_return,
            reached_threshold=training.reached_threshold,
            curve=list(training.curve),
            adjusted_draws=training.adjusted_draws,
            diverged_episodes=training.diverged_episodes,
            confirmation=None if self.training.confirmation is None else training.best,
            networks=networks.to_bytes(training.networks) if self._is_continued else None,
            phases=None if self.curriculum is None else list(training.phases),
        )

    def events(self, result: TrainedPolicy) -> list[RunEvent]:
        return self._evaluated(result.curve)

    def cost(self, speed: CoreSpeed) -> Cost:
        settings, task = self.training, get_task(self.task)
        evaluations = -(-settings.steps // settings.evaluate_every)
        episodes = evaluations * settings.evaluation_episodes + (settings.confirmation or 0)
        simulated = settings.steps + episodes * task.horizon
        observed, actions = len(task.columns), len(task.action_low)
        learning = settings.learning_seconds(observed + actions)
        return Cost(
            seconds=simulated / speed.steps_per_second(self.task) + learning,
            environment_steps=settings.steps,
            policy_bytes=settings.policy_bytes(observed, actions),
        )

    def stand_in(self) -> TrainedPolicy:
        return TrainedPolicy(
            policy=f"policy of {self.digest}".encode(),
            steps=self.training.steps,
            source_return=0.0,
            reached_threshold=False,
            curve=[],
            adjusted_draws=0,
            diverged_episodes=0,
            networks=f"networks of {self.digest}".encode() if self._is_continued else None,
            phases=None
            if self.curriculum is None
            else [Phase(steps=0, distribution=self.distribution.to_json())],
        )

    @property
    def _is_continued(self) -> bool:
        return self.training.start == "previous"

    def _checkpoint(self, policy: Policy, curve: Sequence[Evaluation]) -> Checkpoint:
        return Checkpoint(curve[-1].steps, policy.to_bytes(), tuple(self._evaluated(curve)))

    def _evaluated(self, curve: Sequence[Evaluation]) -> list[RunEvent]:
        return [TrainingEvaluated(digest=self.digest, **point.model_dump()) for point in curve]

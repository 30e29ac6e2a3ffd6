"""Evaluate a policy on the simulated target, for the result table alone."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adr_service.errors import InvalidInput
from adr_service.events import BoundedReturn, RunEvent
from adr_service.progress import Progress
from adr_service.simulation.target import simulate_evaluation
from adr_service.stages.base import CoreSpeed, Cost, Result, Role, Stage, StageResult
from adr_service.tasks.catalogue import get_task
from adr_service.training.policy import Policy


class TargetEvaluation(Result):
    """Returns of full target episodes. No method may see them."""

    returns: list[BoundedReturn]
    diverged_episodes: int


@dataclass(frozen=True, kw_only=True)
class Evaluate(Stage[TargetEvaluation]):
    """Full episodes of one policy on the simulated target."""

    kind: ClassVar = "evaluate"
    version: ClassVar = 2
    role: ClassVar[Role] = "target"
    result: ClassVar = TargetEvaluation

    variant: str  # a domain; the field's name is part of the digest
    episodes: int
    seed: int
    policy: bytes

    def compute(self, rng: np.random.Generator, progress: Progress) -> TargetEvaluation:
        task, act = get_task(self.task), Policy.from_bytes(self.policy).act
        episodes = simulate_evaluation(task, self.variant, act, self.episodes, rng)
        diverged = int(episodes.diverged.sum())
        return TargetEvaluation(returns=episodes.returns.tolist(), diverged_episodes=diverged)

    def read(self, stored: StageResult) -> TargetEvaluation:
        found = super().read(stored)
        if len(found.returns) != self.episodes:
            raise InvalidInput(
                f"an evaluation of {self.episodes} episodes has {len(found.returns)} returns"
            )
        return found

    def events(self, result: TargetEvaluation) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        steps = self.episodes * get_task(self.task).horizon
        return Cost(steps / speed.steps_per_second(self.task))

    def stand_in(self) -> TargetEvaluation:
        return TargetEvaluation(returns=[0.0] * self.episodes, diverged_episodes=0)

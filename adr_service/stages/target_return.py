"""Measure the return of one full episode on the simulated target, for methods that see returns."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import Field

from adr_service.events import RunEvent
from adr_service.progress import Progress
from adr_service.simulation.target import simulate_evaluation
from adr_service.stages.base import CoreSpeed, Cost, Result, Role, Stage
from adr_service.tasks.catalogue import get_task
from adr_service.training.policy import Policy


class EpisodeReturn(Result):
    """The return of one episode; a method sees nothing else of it."""

    earned: float = Field(validation_alias="return", serialization_alias="return")  # undiscounted
    transitions: int


@dataclass(frozen=True, kw_only=True)
class TargetReturn(Stage[EpisodeReturn]):
    """One full episode of a policy on the simulated target."""

    kind: ClassVar = "target_return"
    version: ClassVar = 1
    role: ClassVar[Role] = "target"
    result: ClassVar = EpisodeReturn

    variant: str  # a domain; the field's name is part of the digest
    iteration: int
    seed: int
    policy: bytes

    def compute(self, rng: np.random.Generator, progress: Progress) -> EpisodeReturn:
        act = Policy.from_bytes(self.policy).act
        episode = simulate_evaluation(get_task(self.task), self.variant, act, 1, rng)
        earned, length = float(episode.returns[0]), int(episode.lengths[0])
        return EpisodeReturn(earned=earned, transitions=length)

    def events(self, result: EpisodeReturn) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        horizon = get_task(self.task).horizon
        return Cost(horizon / speed.steps_per_second(self.task), target_transitions=horizon)

    def stand_in(self) -> EpisodeReturn:
        return EpisodeReturn(earned=0.0, transitions=get_task(self.task).horizon)

"""Record one trajectory of a policy on the simulated target."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adr_service.events import RunEvent
from adr_service.progress import Progress
from adr_service.simulation.rollout import random_actions
from adr_service.simulation.target import simulate_rollout
from adr_service.stages.base import CoreSpeed, Cost, Result, Role, Stage
from adr_service.stages.stand_ins import trajectory
from adr_service.tasks.catalogue import get_task
from adr_service.training.policy import Policy


class Rollout(Result):
    """One recorded trajectory."""

    transitions: int
    data: bytes  # a TransitionDataset as .npz


@dataclass(frozen=True, kw_only=True)
class TargetRollout(Stage[Rollout]):
    """One episode on the simulated target, of at most `transitions` control steps."""

    kind: ClassVar = "target_rollout"
    version: ClassVar = 2
    role: ClassVar[Role] = "target"
    result: ClassVar = Rollout

    variant: str  # a domain; the field's name is part of the digest
    transitions: int
    iteration: int
    seed: int
    policy: bytes | None = None  # None: random actions

    def compute(self, rng: np.random.Generator, progress: Progress) -> Rollout:
        task, policy = get_task(self.task), self.policy
        act = random_actions(task, rng) if policy is None else Policy.from_bytes(policy).act
        data = simulate_rollout(task, self.variant, act, self.transitions, rng)
        return Rollout(transitions=len(data), data=data.to_npz())

    def events(self, result: Rollout) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        seconds = self.transitions / speed.steps_per_second(self.task)
        return Cost(seconds, target_transitions=self.transitions)

    def stand_in(self) -> Rollout:
        data = trajectory(self.task, self.transitions, self.digest)
        return Rollout(transitions=self.transitions, data=data)

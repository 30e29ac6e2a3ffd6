"""Propose the next distribution to train on, from the target returns so far."""

from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np

from adr_service.distributions import Distribution, Uniform, check_space
from adr_service.errors import InvalidInput
from adr_service.events import RunEvent
from adr_service.methods.base import Problem, ReturnsSettings
from adr_service.methods.catalogue import methods
from adr_service.parameters import ParameterSpace
from adr_service.progress import Progress
from adr_service.randomness import stream
from adr_service.stages.base import Belief, CoreSpeed, Cost, Result, Role, Stage
from adr_service.tasks.catalogue import get_task, source_of


class Proposed(Result):
    """The next distribution, and the best so far."""

    distribution: Belief
    best: int  # index of the distribution whose policy is believed best
    simulated_steps: int  # control steps; 0 where the target's returns are all that is used
    diagnostics: dict[str, Any]  # JSON


@dataclass(frozen=True, kw_only=True)
class Propose(Stage[Proposed]):
    """One proposal of a method that learns from returns."""

    kind: ClassVar = "propose"
    version: ClassVar = 2  # 2: BayRn's noise has the prior of 2021
    role: ClassVar[Role] = "inference"
    result: ClassVar = Proposed

    variant: str  # a domain; the field's name is part of the digest
    seed: int
    method: dict[str, Any]  # settings, JSON, without those that change no proposal
    method_package: str | None = None
    distributions: list[Distribution]
    returns: list[float]  # of a policy of each distribution, on the target

    @property
    def space(self) -> ParameterSpace:
        """The space of the distributions."""
        return source_of(self.task, self.variant).space

    def compute(self, rng: np.random.Generator, progress: Progress) -> Proposed:
        problem = Problem(get_task(self.task), source_of(self.task, self.variant))
        returns = np.array(self.returns)
        proposal = self._settings.create().propose(problem, self.distributions, returns, rng)
        if not 0 <= proposal.best < len(returns):
            raise InvalidInput(
                f"{self.method['name']} must name the best policy by a number from 0 to "
                f"{len(returns) - 1}; given {proposal.best}"
            )
        check_space(f"the distribution of {self.method['name']}", proposal.next, self.space)
        return Proposed(
            distribution=proposal.next,
            best=proposal.best,
            simulated_steps=proposal.simulated_steps,
            diagnostics={
                "returns_seen": self.returns,
                **proposal.diagnostics,
                "reported": proposal.best,
            },
        )

    def events(self, result: Proposed) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        return Cost(self._settings.seconds)

    def stand_in(self) -> Proposed:
        space = self.space
        share = stream("stand-in", self.digest).random(len(space))
        box = Uniform(space, space.low + share * (space.high - space.low), space.high)
        latest = len(self.returns) - 1
        return Proposed(distribution=box, best=latest, simulated_steps=0, diagnostics={})

    @property
    def _settings(self) -> ReturnsSettings:
        settings = methods()[self.method["name"]].model_validate(self.method)
        return cast(ReturnsSettings, settings)

"""Propose the next distribution to train on, from the target returns so far (BayRn)."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from adr_service.distributions import Uniform
from adr_service.events import RunEvent
from adr_service.methods.bayrn import propose
from adr_service.parameters import ParameterSpace
from adr_service.progress import Progress
from adr_service.randomness import stream
from adr_service.stages.base import Belief, CoreSpeed, Cost, Result, Role, Stage
from adr_service.tasks.catalogue import source_of

_FIT_S = 4.0  # of the Gaussian process and its acquisition, with the import of BoTorch


class Proposed(Result):
    """The next distribution, and the best so far."""

    distribution: Belief
    best: int  # index of the distribution whose policy is believed best
    simulated_steps: int  # none: the target's returns are all that it uses
    diagnostics: dict[str, Any]  # JSON


@dataclass(frozen=True, kw_only=True)
class Propose(Stage[Proposed]):
    """One step of Bayesian optimisation over uniform distributions."""

    kind: ClassVar = "propose"
    version: ClassVar = 1
    role: ClassVar[Role] = "inference"
    result: ClassVar = Proposed

    variant: str  # a domain; the field's name is part of the digest
    seed: int
    method: dict[str, Any]  # settings, JSON
    distributions: list[Uniform]
    returns: list[float]  # of a policy of each distribution, on the target

    @property
    def space(self) -> ParameterSpace:
        """The space of the distributions."""
        return source_of(self.task, self.variant).space

    def compute(self, rng: np.random.Generator, progress: Progress) -> Proposed:
        proposal = propose(self.distributions, np.array(self.returns), rng)
        return Proposed(
            distribution=proposal.next,
            best=proposal.best,
            simulated_steps=0,
            diagnostics={
                "returns_seen": self.returns,
                "posterior_means": proposal.means.tolist(),
                "reported": proposal.best,
            },
        )

    def events(self, result: Proposed) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        return Cost(_FIT_S)

    def stand_in(self) -> Proposed:
        space = self.space
        share = stream("stand-in", self.digest).random(len(space))
        box = Uniform(space, space.low + share * (space.high - space.low), space.high)
        latest = len(self.returns) - 1
        return Proposed(distribution=box, best=latest, simulated_steps=0, diagnostics={})

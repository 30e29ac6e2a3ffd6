"""Uniform domain randomization (UDR): the baseline that learns from no data.

Tiboni et al., the benchmark's paper, Sec. 3.2: the mean over policies that are trained on uniform
bounds, drawn at random within the search space.

The paper does not state how it draws the bounds. Here each parameter has two uniform draws, sorted.

`fixed_dr` is what others call uniform domain randomization: one policy, trained on the whole search
box from its first step to its last. It is the baseline of the methods that move their distribution
(Tiboni et al., arXiv 2311.01885).
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.arrays import Matrix, Vector
from adr_service.citations import Paper
from adr_service.distributions import Draws, Uniform
from adr_service.methods.base import CurriculumSettings, Data, MethodSettings, Problem
from adr_service.parameters import ParameterSpace

PAPER = Paper(
    "tobin2017domain",
    "Domain Randomization for Transferring Deep Neural Networks from Simulation to the Real World",
    "Tobin, Josh and Fong, Rachel and Ray, Alex and Schneider, Jonas and Zaremba, Wojciech and "
    "Abbeel, Pieter",
    2017,
    arxiv="1703.06907",
)


class UdrSettings(MethodSettings):
    name: Literal["udr"] = "udr"
    policies: int = Field(10, ge=1, le=1000, description="random bounds, one policy each")

    program: ClassVar[str] = "adr_service.programs.udr"
    learns_from: ClassVar[Data] = "nothing"
    label: ClassVar[str] = "UDR"
    colour: ClassVar[str] = "#E69F00"
    papers: ClassVar[tuple[Paper, ...]] = (PAPER,)


def random_bounds(
    space: ParameterSpace, settings: UdrSettings, rng: np.random.Generator
) -> list[Uniform]:
    """`settings.policies` random boxes inside the search bounds (Sec. 3.2)."""
    corners = np.sort(
        rng.uniform(space.low, space.high, (settings.policies, 2, len(space))), axis=1
    )
    return [Uniform(space, low, high) for low, high in corners]


class FixedDrSettings(CurriculumSettings):
    name: Literal["fixed_dr"] = "fixed_dr"
    episodes: int = Field(
        64, ge=1, le=100_000, description="episodes between two records of their mean return"
    )

    label: ClassVar[str] = "fixed DR"
    colour: ClassVar[str] = "#BBBB00"
    papers: ClassVar[tuple[Paper, ...]] = (PAPER,)

    def create(self, problem: Problem) -> "FixedDr":
        return FixedDr(self, problem)


class FixedDr:
    """A curriculum that never moves."""

    def __init__(self, settings: FixedDrSettings, problem: Problem):
        space = problem.source.space
        self.episodes = settings.episodes
        self.distribution = Uniform(space, space.low, space.high)

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        return self.distribution.sample(n, rng)

    def move(self, dynamics: Matrix, returns: Vector) -> None:
        """Stay."""

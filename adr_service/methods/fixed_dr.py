"""Domain randomization over the whole search box, from the first step of a training to the last.

The baseline of the methods that move their distribution (Tiboni et al., arXiv 2311.01885, Sec. 5).
UDR of the benchmark's paper has smaller random boxes instead.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.arrays import Matrix, Vector
from adr_service.distributions import Draws, Uniform
from adr_service.methods.base import CurriculumSettings, Problem


class FixedDrSettings(CurriculumSettings):
    name: Literal["fixed_dr"] = "fixed_dr"
    episodes: int = Field(
        64, ge=1, le=100_000, description="episodes of which each mean return is recorded"
    )

    label: ClassVar[str] = "fixed DR"
    colour: ClassVar[str] = "#BBBB00"

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

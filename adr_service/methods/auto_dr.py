"""Automatic domain randomization (AutoDR): a box that grows where the policy copes.

OpenAI et al.: "Solving Rubik's Cube with a Robot Hand", arXiv 1910.07113.
It starts narrow. With some probability an episode has one parameter at one bound of the box. When
a bound has enough of them, it moves outwards if their mean return is high, inwards if it is low.

Where we differ:
- Bounds stay until the policy has earned the high threshold once on the first box, as in Tiboni et
  al.'s comparison (arXiv 2311.01885), where returns of that phase count for bounds already.
- The policy learns from the episodes at the bounds too.
- Returns come in phases of episodes (`training.curriculum`), so a bound moves at a phase's end.
- The high threshold is .75 of the reward threshold, as DORAEMON's success is here: these are
  returns of the exploring policy. The low one is half of it.
- The paper starts from a point. Here the first box is one step wide, so that its two bounds differ,
  and no box is narrower later.
"""

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from adr_service.arrays import Matrix, Vector, frozen
from adr_service.citations import Paper
from adr_service.distributions import Draws, Uniform
from adr_service.methods.base import CurriculumSettings, Problem

PAPER = Paper(
    "openai2019rubik",
    "Solving Rubik's Cube with a Robot Hand",
    "{OpenAI}",
    2019,
    arxiv="1910.07113",
)


class AutoDrSettings(CurriculumSettings):
    name: Literal["auto_dr"] = "auto_dr"
    episodes: int = Field(64, ge=1, le=100_000, description="episodes between moves, at least")
    boundary: float = Field(
        0.5, gt=0, le=1, description="share of episodes that have a parameter at a bound"
    )
    buffer: int = Field(20, ge=1, le=10_000, description="returns at a bound before it moves")
    step: float = Field(0.05, gt=0, le=1, description="of a bound, as a share of its search range")
    high: float = Field(
        0.75, gt=0, description="share of the reward threshold from which a bound moves outwards"
    )
    low: float = Field(
        0.375, gt=0, description="share of the reward threshold up to which it moves inwards"
    )

    label: ClassVar[str] = "AutoDR"
    colour: ClassVar[str] = "#117733"
    papers: ClassVar[tuple[Paper, ...]] = (PAPER,)

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low: {self.low} given, which is not below high, {self.high}")
        return self

    def create(self, problem: Problem) -> "AutoDr":
        return AutoDr(self, problem)


class AutoDr:
    """A box with a buffer of returns for each of its 2 d sides, the lower ones first."""

    def __init__(self, settings: AutoDrSettings, problem: Problem):
        self._settings, self._space = settings, problem.source.space
        self._threshold = problem.task.reward_threshold
        self.episodes = settings.episodes
        d = len(self._space)
        centre = (self._space.low + self._space.high) / 2
        half = settings.step * (self._space.high - self._space.low) / 2
        first = np.array([centre - half, centre + half])  # (2, d)
        # rounding may lead beyond the search range
        self._bounds = np.clip(first, self._space.low, self._space.high)
        self._buffers: list[list[list[float]]] = [[[] for _ in range(d)] for _ in range(2)]
        self._has_started = False

    @property
    def distribution(self) -> Uniform:
        return Uniform(self._space, *self._bounds)

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        values = self.distribution.sample(n, rng).values.copy()
        rows = np.flatnonzero(rng.random(n) < self._settings.boundary)
        sides = rng.integers(2, size=len(rows))
        columns = rng.integers(len(self._space), size=len(rows))
        values[rows, columns] = self._bounds[sides, columns]
        return Draws(frozen(values), 0)

    def move(self, dynamics: Matrix, returns: Vector) -> None:
        if not self._has_started:
            self._has_started = bool(np.mean(returns) >= self._settings.high * self._threshold)
            return
        for side, column in np.ndindex(self._bounds.shape):
            at_bound = dynamics[:, column] == self._bounds[side, column]
            self._buffers[side][column] += returns[at_bound].tolist()
        for side, column in np.ndindex(self._bounds.shape):
            if len(self._buffers[side][column]) >= self._settings.buffer:
                self._move(side, column)

    def _move(self, side: int, column: int) -> None:
        """Move a bound by what its full buffer says, and empty that."""
        mean = np.mean(self._buffers[side][column])
        self._buffers[side][column] = []
        outwards = (-1, 1)[side] * self._settings.step
        if mean >= self._settings.high * self._threshold:
            self._shift(side, column, outwards)
        elif mean <= self._settings.low * self._threshold:
            self._shift(side, column, -outwards)

    def _shift(self, side: int, column: int, share: float) -> None:
        """Shift a bound within the search range, and no closer to the other one than a step."""
        low, high = self._space.low[column], self._space.high[column]
        step = self._settings.step * (high - low)
        wanted = self._bounds[side, column] + share * (high - low)
        ranges = (low, self._bounds[1, column] - step), (self._bounds[0, column] + step, high)
        kept = np.clip(wanted, *ranges[side])
        self._bounds[side, column] = np.clip(kept, low, high)  # beyond which rounding may lead

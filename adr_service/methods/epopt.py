"""EPOpt: train where the policy does worst, for the conditional value at risk of its return.

Rajeswaran et al.: "EPOpt: Learning Robust Neural Network Policies Using Model Ensembles", arXiv
1610.01283. The dynamics in which the policy earns the lowest `epsilon` of
returns are those that it learns from. In a number of first rounds it learns from all of them.

Where we differ: the paper draws dynamics, runs a trajectory in each, and updates the policy on the
worst trajectories alone. Our trainings learn from every step. So phases take turns: one draws from
the whole search box, and `focus` phases draw from the worst dynamics of that one. The share
1 / (1 + focus) of the phases is not from the worst, and dynamics are chosen, as in the paper's
objective, and not trajectories. `epsilon` is .2, as in SimuRLacra's examples; the paper has .1. The
paper's source distributions are truncated normals; ours is the whole box, as that of the other
methods without target data. We leave out its adaptation to target data.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.arrays import Matrix, Vector
from adr_service.citations import Paper
from adr_service.distributions import Distribution, Draws, Empirical, Uniform
from adr_service.methods.base import CurriculumSettings, Problem

PAPER = Paper(
    "rajeswaran2017epopt",
    "EPOpt: Learning Robust Neural Network Policies Using Model Ensembles",
    "Rajeswaran, Aravind and Ghotra, Sarvjeet and Ravindran, Balaraman and Levine, Sergey",
    2017,
    conference="International Conference on Learning Representations",
    arxiv="1610.01283",
)


class EpOptSettings(CurriculumSettings):
    name: Literal["epopt"] = "epopt"
    episodes: int = Field(64, ge=2, le=100_000, description="episodes of a phase, at least")
    epsilon: float = Field(
        0.2, gt=0, lt=1, description="share of dynamics, the worst, that the policy learns from"
    )
    skip: int = Field(12, ge=0, le=10_000, description="first phases, all from the whole box")
    focus: int = Field(
        3, ge=1, le=1000, description="phases on the worst dynamics of a phase on the whole box"
    )

    label: ClassVar[str] = "EPOpt"
    colour: ClassVar[str] = "#44AA99"
    papers: ClassVar[tuple[Paper, ...]] = (PAPER,)

    def create(self, problem: Problem) -> "EpOpt":
        return EpOpt(self, problem)


class EpOpt:
    def __init__(self, settings: EpOptSettings, problem: Problem):
        self._settings, self._space = settings, problem.source.space
        self._whole = Uniform(self._space, self._space.low, self._space.high)
        self.episodes = settings.episodes
        self.distribution: Distribution = self._whole
        self._to_skip, self._left = settings.skip, 0  # phases

    def sample(self, n: int, rng: np.random.Generator) -> Draws:
        return self.distribution.sample(n, rng)

    def move(self, dynamics: Matrix, returns: Vector) -> None:
        if self._to_skip > 0:
            self._to_skip -= 1
        elif self._left > 1:
            self._left -= 1
        elif self._left == 1:
            self._left, self.distribution = 0, self._whole
        else:
            # without the rounding of floats: .28 * 50 is a bit above 14
            count = max(int(np.ceil(np.round(self._settings.epsilon * len(returns), 9))), 1)
            worst = np.argsort(returns, kind="stable")[:count]
            self._left = self._settings.focus
            self.distribution = Empirical.equal(self._space, dynamics[worst])

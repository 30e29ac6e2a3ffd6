"""BayesSim: a mixture of Gaussians, learnt from simulated trajectories.

Ramos et al.: "BayesSim: adaptive domain randomization via probabilistic inference for robotics
simulators", arXiv 1906.01728. Parameters are drawn from the prior, the recorded actions
are replayed under each, and a mixture density network learns the parameters from the summary of a
replay. Given the recording's summary, it is the posterior.

Choices, and where we differ:
- The prior is uniform over the search box (the benchmark's is N(2, I)), and is the proposal: there
  is one round.
- We use the paper's plain network, without random features, with sbi's 50 units per layer and
  SimuRLacra's five components.
- Replays are open loop and whole, as SimuRLacra's. `segment` sets them to the recorded state again.
- Draws of the posterior beyond the search box are clipped, as a Gaussian's are, and so are the
  means of its Gaussians (`moved_means` counts them, however little they weigh). Of one that was
  moved half the draws are at the bound, and the others lie farther inside than the network said.
- Statistics are scaled by their quartiles and compressed, because replays of a robot that falls
  have long tails.
- Statistics are means over the rows of all trajectories. SimuRLacra concatenates those of each,
  which must be of one length then, and tell more.
- Replays that diverge are left out and counted.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.citations import SBI, Paper
from adr_service.distributions import Mixture
from adr_service.methods.base import Estimate, OfflineSettings, Problem
from adr_service.progress import Progress, part_of
from adr_service.simulation.summaries import LEAST, Scale, SummarisedReplays, outside
from adr_service.startup_time import preparing
from adr_service.transitions import TransitionDataset

_BATCH = 64  # replays at once

PAPER = Paper(
    "ramos2019bayessim",
    "BayesSim: adaptive domain randomization via probabilistic inference for robotics simulators",
    "Ramos, Fabio and Possas, Rafael Carvalhaes and Fox, Dieter",
    2019,
    conference="Robotics: Science and Systems",
    arxiv="1906.01728",
)


class BayesSimSettings(OfflineSettings):
    name: Literal["bayes_sim"] = "bayes_sim"
    simulations: int = Field(2000, ge=LEAST, le=1_000_000, description="replays of the data")
    components: int = Field(5, ge=1, le=100, description="Gaussians in the mixture")
    segment: int | None = Field(
        None,
        ge=1,
        le=100_000,
        description="steps after which a replay is set to the recorded state; null: whole episodes",
    )
    epochs: int = Field(
        1000,
        ge=1,
        le=1_000_000,
        description="passes over a round's simulations, at most; sbi makes one more",
    )

    extra: ClassVar[str] = "sbi"
    label: ClassVar[str] = "BayesSim"
    colour: ClassVar[str] = "#661100"
    papers: ClassVar[tuple[Paper, ...]] = (PAPER, SBI)

    @property
    def seconds(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Seconds of training the network, which took 20 on 2000 simulations of the arm."""
        return 20.0 * self.simulations / 2000

    def create(self) -> "BayesSim":
        return BayesSim(self)

    def planned_steps(self, parameters: int, transitions: int) -> int:
        return self.simulations * transitions


class BayesSim:
    def __init__(self, settings: BayesSimSettings):
        self._settings = settings

    def fit(
        self,
        problem: Problem,
        data: TransitionDataset,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Estimate:
        # sbi takes seconds to import, which only an inference should cost
        with preparing():
            from adr_service.search.neural_posterior import MixturePosterior

        settings, space = self._settings, problem.source.space
        replays = SummarisedReplays(problem.task, problem.source, data, _BATCH, settings.segment)
        points = rng.random((settings.simulations, len(space)))
        dynamics = space.denormalise(space.WIDTH * points)
        held, simulated = replays.usable(dynamics, part_of(progress, 0, 2))
        progress(0.5, simulations=settings.simulations)
        scale = Scale.of(simulated)
        posterior = MixturePosterior(len(space), settings.components, settings.epochs, rng)
        posterior.learn(points[held], scale(simulated))
        weights, means, covariances = posterior.mixture(scale(replays.recorded))
        inside = np.clip(means, 0.0, 1.0)
        progress(1.0, simulations=settings.simulations)
        return Estimate(
            Mixture(space, weights, space.WIDTH * inside, space.WIDTH**2 * covariances),
            simulated_steps=settings.simulations * len(data),
            diagnostics={
                "epochs": posterior.epochs,
                "diverged_replays": int(np.sum(~held)),
                "moved_means": int(np.sum(np.any(means != inside, axis=1))),
                "statistics_outside": outside(simulated, replays.recorded),
            },
        )

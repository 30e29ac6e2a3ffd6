"""NPDR: samples of a posterior that a normalising flow learns in rounds.

Muratore et al.: "Neural Posterior Domain Randomization", CoRL 2021. Sequential neural posterior
estimation (SNPE-C; Greenberg et al., arXiv 1905.07488): a first round draws parameters from the
prior, the next ones from the posterior so far, where the recording's own parameters are likely.
Replays are set to the recorded state at the start of each segment. Policies are trained on samples
of the posterior.

Choices, and where we differ:
- The prior is uniform over the search box (the benchmark's is N(2, I)).
- The flow is masked autoregressive, with 5 transforms, 10 atoms and the combined loss, as
  SimuRLacra's. It is Zuko's and not nflows': each transform has five hidden layers of 50 units and
  not two, and the order of parameters is reversed in place of permuted.
- It learns logits of the parameters in the search box, so that no sample leaves it: multi-round
  estimates leak otherwise (sbi, issue 287). Samples closer to a bound than 1e-7 of the box
  are moved to that distance, and are not counted. Where fewer than 10 simulations are held out to
  end a training, the loss on these has as many atoms as there are (`validation_atoms`).
- It is trained as sbi does by default (batches of 200, learning rate 5e-4, a tenth held out);
  SimuRLacra's experiments set 50, 3e-4 and a fifth.
- With one unknown parameter the flow's transforms are affine: the posterior of its logit is normal.
- Summaries are BayesSim's, one of SimuRLacra's choices, scaled by quartiles and compressed.
- Statistics are means over the rows of all trajectories. SimuRLacra concatenates those of each,
  which must be of one length then, and tell more.
- `draws` samples are trained on. SimuRLacra draws 10 * 2^d, which has no end for 30 parameters.
- The paper runs it online too; here it is offline, and gets what SimOpt collects.
- Replays that diverge are left out and counted.
- `statistics_outside` counts, for each round, the statistics of the recording beyond those of this
  round's replays: only the first round's are of the whole search box.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.citations import SBI, Paper
from adr_service.distributions import Empirical
from adr_service.methods.base import Estimate, OfflineSettings, Problem
from adr_service.progress import Progress, part_of
from adr_service.simulation.summaries import LEAST, Scale, SummarisedReplays, outside
from adr_service.startup_time import preparing
from adr_service.transitions import TransitionDataset

_BATCH = 64  # replays at once

PAPER = Paper(
    "muratore2022npdr",
    "Neural Posterior Domain Randomization",
    "Muratore, Fabio and Gruner, Theo and Wiese, Florian and Belousov, Boris and "
    "Gienger, Michael and Peters, Jan",
    2022,
    conference="Conference on Robot Learning",
)
SNPE_C = Paper(
    "greenberg2019automatic",
    "Automatic Posterior Transformation for Likelihood-Free Inference",
    "Greenberg, David S. and Nonnenmacher, Marcel and Macke, Jakob H.",
    2019,
    conference="International Conference on Machine Learning",
    arxiv="1905.07488",
)


class NpdrSettings(OfflineSettings):
    name: Literal["npdr"] = "npdr"
    rounds: int = Field(4, ge=1, le=100, description="rounds of simulations")
    simulations: int = Field(500, ge=LEAST, le=1_000_000, description="replays per round")
    segment: int | None = Field(
        10,
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
    draws: int = Field(
        200, ge=1, le=10_000, description="samples of the posterior that policies are trained on"
    )

    extra: ClassVar[str] = "sbi"
    label: ClassVar[str] = "NPDR"
    colour: ClassVar[str] = "#6699CC"
    papers: ClassVar[tuple[Paper, ...]] = (PAPER, SNPE_C, SBI)

    @property
    def seconds(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Seconds of training the network, which took 40 on four rounds of 500 for the arm.

        Each round trains on the simulations of all rounds so far.
        """
        trained_on = self.simulations * self.rounds * (self.rounds + 1) / 2
        return 40.0 * trained_on / 5000

    def create(self) -> "Npdr":
        return Npdr(self)

    def planned_steps(self, parameters: int, transitions: int) -> int:
        return self.rounds * self.simulations * transitions


class Npdr:
    def __init__(self, settings: NpdrSettings):
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
            from adr_service.search.neural_posterior import FlowPosterior

        settings, space = self._settings, problem.source.space
        replays = SummarisedReplays(problem.task, problem.source, data, _BATCH, settings.segment)
        posterior, scale = FlowPosterior(len(space), settings.epochs, rng), None
        diverged, unlike = list[int](), list[int]()  # in each round
        for number in range(settings.rounds):
            points = (
                rng.random((settings.simulations, len(space)))
                if number == 0
                else posterior.sample(settings.simulations)
            )
            dynamics = space.denormalise(space.WIDTH * points)
            half = part_of(progress, 2 * number, 2 * settings.rounds)
            held, simulated = replays.usable(dynamics, half)
            scale = scale or Scale.of(simulated)  # of the first round, for all of them
            posterior.learn(points[held], scale(simulated), scale(replays.recorded))
            diverged.append(int(np.sum(~held)))
            unlike.append(outside(simulated, replays.recorded))
            progress((number + 1) / settings.rounds, diverged=diverged[-1])
        samples, atoms = posterior.sample(settings.draws), posterior.validation_atoms
        return Estimate(
            Empirical.equal(space, space.denormalise(space.WIDTH * samples)),
            simulated_steps=settings.rounds * settings.simulations * len(data),
            diagnostics={
                "epochs": posterior.epochs,
                "diverged_replays": diverged,
                "statistics_outside": unlike,
                # not where there are as many as in training, so that results keep their bytes
                **({} if atoms is None else {"validation_atoms": atoms}),
            },
        )

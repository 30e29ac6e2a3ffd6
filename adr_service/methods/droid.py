"""DROID: replay the recorded actions open loop, and let CMA-ES bring the observations together.

Tsai et al.: "DROID: Minimizing the Reality Gap using Single-Shot Human Demonstration", arXiv
2102.11003, as the benchmark adapts it (Tiboni et al., Sec. 3.2): the recorded actions from the
recorded initial state, without resets in between; the cost is the L2 norm between recorded and
simulated observations; the search's final Gaussian is the distribution to train on.

What neither paper states, and is a setting or chosen here: the budget, which decides how narrow
the answer is; no weights; several trajectories are one long vector under the norm. Simulations
go on for the whole recorded length, falling or not, so nothing is gained by dying early; a
diverged one is the worst.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.arrays import Matrix, Vector
from adr_service.distributions import Gaussian
from adr_service.errors import InvalidInput
from adr_service.methods.base import Estimate, OfflineSettings, Problem
from adr_service.progress import Progress
from adr_service.search.cma_es import belief, strategy
from adr_service.simulation.batch import Simulations
from adr_service.simulation.replay import check_recorded
from adr_service.tasks.base import State
from adr_service.transitions import TransitionDataset


class DroidSettings(OfflineSettings):
    name: Literal["droid"] = "droid"
    budget: int = Field(1000, ge=1, le=1_000_000, description="simulated replays of the data")
    initial_std: float = Field(1.0, gt=0, description="of the search, in [0, 4] coordinates")

    label: ClassVar[str] = "DROID"
    colour: ClassVar[str] = "#CC79A7"

    def create(self) -> "Droid":
        return Droid(self)

    def planned_steps(self, parameters: int, transitions: int) -> int:
        return self.budget * transitions


class Droid:
    def __init__(self, settings: DroidSettings):
        self._settings = settings

    def fit(
        self,
        problem: Problem,
        data: TransitionDataset,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Estimate:
        settings, space = self._settings, problem.source.space
        middle = np.full(len(space), space.WIDTH / 2)
        es = strategy(middle, std=settings.initial_std, width=space.WIDTH, rng=rng)
        replay = _OpenLoop(problem, data, es.popsize)
        evaluations, diverged, costs = 0, 0, np.array([np.inf])
        while evaluations < settings.budget and not es.stop():
            candidates = es.ask()
            costs = replay.costs(space.denormalise(np.array(candidates)))
            broken = ~np.isfinite(costs)
            diverged += int(broken.sum())
            if broken.all():
                raise InvalidInput(f"all {len(costs)} candidates of a population diverged")
            es.tell(candidates, np.where(broken, 10 * costs[~broken].max(), costs).tolist())
            evaluations += len(candidates)
            progress(evaluations / settings.budget, cost=float(costs[~broken].min()))
        mean, covariance = belief(es)
        return Estimate(
            Gaussian(space, mean, covariance),
            simulated_steps=evaluations * len(data),
            diagnostics={
                "evaluations": evaluations,
                "stopped_by": sorted(es.stop() or ()),
                "last_best_cost": float(np.nanmin(costs)),
                "diverged_replays": diverged,
                "std": np.sqrt(np.diag(covariance)).tolist(),
            },
        )


class _OpenLoop:
    """The distance of replayed episodes from recorded ones."""

    def __init__(self, problem: Problem, data: TransitionDataset, n: int):
        check_recorded(problem.task, data)
        self._task, self._episodes = problem.task, data.split()
        self._simulations = Simulations(problem.task, problem.source, n)

    def costs(self, dynamics: Matrix) -> Vector:
        """L2 norm over all episodes, steps and columns, (n,); not finite where diverged."""
        simulations, measured = self._simulations, self._task.measured
        simulations.set_dynamics(dynamics)
        total = np.zeros(simulations.n)
        for episode in self._episodes:
            first = self._task.state(episode.observations[:1])
            simulations.set_state(State(first.qpos, first.qvel))
            for action, recorded in zip(episode.actions, episode.next_observations, strict=True):
                simulations.step(action)
                seen = self._task.observe(simulations.state)[:, :measured]
                total += np.sum((seen - recorded) ** 2, axis=1)
        return np.sqrt(total)

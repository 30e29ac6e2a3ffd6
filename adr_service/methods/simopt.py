"""SimOpt: move the distribution until simulated trajectories look like the target's.

Chebotar et al.: "Closing the Sim-to-Real Loop", arXiv 1810.05687, as the benchmark runs it:
one target trajectory per iteration, then several REPS updates of a Gaussian over the [0, 4]
coordinates, from closed-loop simulations with the policy that made the trajectory.

Where we differ, and why:
- Observations are weighted by the inverse standard deviation of the target's columns; the
  paper hand-tunes W per task. Errors are averaged over time, not summed, so that long
  trajectories do not count more (as in SimuRLacra).
- Simulations run for the whole recorded length, falling or not, so that nothing is gained by
  dying early; a diverged one costs as much as the worst that did not.
- Costs are divided by the distance of their 90th percentile from the best before REPS, so that
  the minimum temperature has no unit and an outlier does not decide it.
"""

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.distributions import Gaussian
from adr_service.methods.base import Evidence, OnlineSettings, Problem, Update
from adr_service.progress import Progress, part_of
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import follow
from adr_service.tasks.base import State

_LEAST_RATIO = 1e-12  # of the new variance to the old, below which the fit is singular


class _Settings(OnlineSettings):
    updates: int
    samples: int = Field(
        1000, ge=10, le=100_000, description="simulated parameter samples per update"
    )
    kl_threshold: float = Field(1.0, gt=0, description="trust region of one update [nat]")
    covariance_damping: float = Field(2.0, gt=0)
    min_temperature: float = Field(1e-3, gt=0)
    l1_weight: float = Field(0.5, ge=0)
    l2_weight: float = Field(1.0, ge=0)
    filter_std: float = Field(5.0, ge=0, description="Gaussian filter over time [steps]")

    def create(self) -> "SimOpt":
        return SimOpt(self)

    def planned_steps(self, parameters: int, transitions: int) -> int:
        return self.updates * self.samples * transitions


class SimOptSettings(_Settings):
    name: Literal["simopt"] = "simopt"
    updates: int = Field(5, ge=1, le=1000, description="REPS updates per target trajectory")

    collects: ClassVar[bool] = True  # benchmark, Sec. 3.4
    label: ClassVar[str] = "SimOpt"
    colour: ClassVar[str] = "#0072B2"


class SimOpt1Settings(_Settings):
    """SimOpt-1 (benchmark, Sec. 3.2): all updates at once, on data of the prior's policy."""

    name: Literal["simopt_1"] = "simopt_1"
    updates: int = Field(25, ge=1, le=1000, description="REPS updates, from the prior")

    program: ClassVar[str] = "adr_service.programs.single_shot"
    label: ClassVar[str] = "SimOpt-1"
    colour: ClassVar[str] = "#56B4E9"


class SimOpt:
    def __init__(self, settings: _Settings):
        self._settings = settings

    def start(self, problem: Problem) -> dict[str, Any]:
        return Gaussian.prior(problem.source.space).to_json()

    def ask(self, problem: Problem, state: dict[str, Any]) -> Gaussian:
        return Gaussian(problem.source.space, state["location"], state["covariance"])

    def tell(
        self,
        problem: Problem,
        state: dict[str, Any],
        evidence: Evidence,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Update:
        settings, belief = self._settings, self.ask(problem, state)
        replay = _ClosedLoop(problem, evidence, settings)
        history: list[dict[str, Any]] = []
        for update in range(settings.updates):
            draws = belief.sample(settings.samples, rng)
            costs = replay.costs(draws.values, part_of(progress, update, settings.updates))
            coordinates = problem.source.space.normalise(draws.values)
            location, covariance, temperature = reps(
                coordinates, costs, belief.covariance, settings
            )
            belief = Gaussian(problem.source.space, location, covariance)
            history.append(
                {
                    "median_cost": float(np.median(costs)),
                    "temperature": temperature,
                    "clipped_draws": draws.adjusted,
                    "diverged": replay.diverged,
                    "std": np.sqrt(np.diag(covariance)).tolist(),
                }
            )
        steps = settings.updates * settings.samples * len(evidence.data)
        return Update(belief.to_json(), steps, {"updates": history})


class _ClosedLoop:
    """Discrepancy between recorded trajectories and the policy's simulated ones."""

    def __init__(self, problem: Problem, evidence: Evidence, settings: _Settings):
        self._task, self._settings = problem.task, settings
        self._act = evidence.policy.act
        self._simulations = Simulations(problem.task, problem.source, settings.samples)
        self._episodes = [
            np.concatenate([part.observations, part.next_observations[-1:]])
            for part in evidence.data.split()
        ]
        deviation = np.concatenate(self._episodes).std(axis=0)
        # a column that never moved has no scale of its own
        self._weights: Vector = 1 / np.where(deviation > 0, deviation, 1.0)
        self.diverged = 0  # simulations in the last call

    def costs(self, dynamics: Matrix, progress: Progress) -> Vector:
        """Discrepancy of each sample, (n,), summed over the recorded episodes."""
        self._simulations.set_dynamics(dynamics)
        total = np.zeros(len(dynamics))
        for index, recorded in enumerate(self._episodes):
            first = self._task.state(recorded[:1])
            n = len(dynamics)
            start = State(np.tile(first.qpos, (n, 1)), np.tile(first.qvel, (n, 1)))
            simulated = follow(
                self._task,
                self._simulations,
                self._act,
                start,
                len(recorded) - 1,
                part_of(progress, index, len(self._episodes)),
            )
            total += self._discrepancy(simulated, recorded)
        broken = ~np.isfinite(total)
        self.diverged = int(broken.sum())
        return np.where(broken, np.max(total[~broken], initial=0.0), total)

    def _discrepancy(self, simulated: Array3, recorded: Matrix) -> Vector:
        """arXiv 1810.05687, eq. 4, averaged over time."""
        settings = self._settings
        error = (simulated - recorded) * self._weights
        if settings.filter_std > 0:  # the filter is linear: filter the difference
            error = gaussian_filter1d(error, settings.filter_std, axis=1)
        l1 = np.mean(np.sum(np.abs(error), axis=2), axis=1)
        l2 = np.mean(np.sum(error**2, axis=2), axis=1)
        return settings.l1_weight * l1 + settings.l2_weight * l2


def reps(
    samples: Matrix, costs: Vector, covariance: Matrix, settings: _Settings
) -> tuple[Vector, Matrix, float]:
    """One REPS step: the new mean (d,), covariance (d, d), and the temperature.

    Samples (n, d) were drawn from a Gaussian of `covariance` and clipped to the search box. The
    step of guided policy search's `TrajOptPI2`, which the benchmark cites: dual in the
    temperature, weighted maximum likelihood, and a covariance that keeps its shape and is scaled
    by the damped average change.
    """
    spread = np.percentile(costs, 90) - costs.min()
    scaled = (costs - costs.min()) / (spread if spread > 0 else 1.0)

    def dual(eta: Vector) -> float:
        # eta eps + eta log mean exp(-c / eta), with min c = 0
        return float(eta[0] * (settings.kl_threshold + np.log(np.mean(np.exp(-scaled / eta[0])))))

    solution = minimize(dual, [1.0], method="L-BFGS-B", bounds=[(settings.min_temperature, None)])
    eta = float(solution.x[0])
    while True:
        weights = np.exp(-scaled / eta)
        weights /= weights.sum()
        mean = weights @ samples
        centred = samples - mean
        likely = (weights[:, None] * centred).T @ centred
        ratio = np.trace(np.linalg.solve(covariance, likely)) / len(mean)
        if ratio > _LEAST_RATIO:
            return mean, ratio ** (1 / settings.covariance_damping) * covariance, eta
        eta *= 2  # as TrajOptPI2 does: one sample has all the weight, there is no spread to fit

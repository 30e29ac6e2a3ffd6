"""Summary statistics of trajectories, and of open-loop replays under other dynamics.

    replays = SummarisedReplays(task, source, data, n=64, length=10)
    replays.recorded                    # (k,) of the recording
    replays.simulate(dynamics)          # (n, k), NaN where diverged

The statistics are those of BayesSim (Ramos et al., arXiv 1906.01728): inner products of
state changes and actions, and means and variances of state changes.
"""

from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Array3, Mask, Matrix, Vector
from adr_service.errors import InvalidInput
from adr_service.progress import Progress, silent
from adr_service.simulation.batch import Batches, Simulations
from adr_service.simulation.replay import check_replayable
from adr_service.tasks.base import Source, State, Task
from adr_service.transitions import TransitionDataset

LEAST = 20  # simulations that a posterior is learnt from


class SummarisedReplays:
    """Replays of a recording's actions, set to its states every `length` steps.

    Without a length, each episode is one replay. Parts never cross an episode.
    """

    def __init__(
        self, task: Task, source: Source, data: TransitionDataset, n: int, length: int | None
    ):
        check_replayable(task, data, length)
        self._task, self._batches = task, Batches(task, source, n)
        self._actions = data.actions
        self._observations = data.observations
        self._starts = _starts(data, length)
        changes = data.next_observations - data.observations
        self.recorded = summary(changes[None], data.actions)[0]

    def simulate(self, dynamics: Matrix, progress: Progress = silent) -> Matrix:
        """Summaries (n, k) of replays under dynamics (n, d), in batches of the constructor's n."""
        return self._batches.run(self._simulate, dynamics, progress)

    def usable(self, dynamics: Matrix, progress: Progress = silent) -> tuple[Mask, Matrix]:
        """A mask (n,) of the dynamics (n, d) whose replays stay finite, and the summaries of those.

        Raises InvalidInput if those are too few to learn from.
        """
        simulated = self.simulate(dynamics, progress)
        held = np.all(np.isfinite(simulated), axis=1)
        if np.sum(held) < LEAST:
            raise InvalidInput(
                f"{np.sum(~held)} of {len(held)} replays diverged, and a posterior is learnt from "
                f"{LEAST} others at least; a shorter `segment` helps"
            )
        return held, simulated[held]

    def _simulate(self, simulations: Simulations) -> Matrix:
        measured = self._task.measured
        changes = np.empty((simulations.n, len(self._actions), measured))
        before = np.empty((simulations.n, measured))
        for row, action in enumerate(self._actions):
            if row in self._starts:
                recorded = self._observations[row : row + 1]
                state = self._task.state(recorded)
                simulations.set_state(State(state.qpos, state.qvel))
                before = np.repeat(recorded[:, :measured], simulations.n, axis=0)
            simulations.step(action)
            after = self._task.observe(simulations.state)[:, :measured]
            changes[:, row], before = after - before, after
        return summary(changes, self._actions)


def summary(changes: Array3, actions: Matrix) -> Matrix:
    """Statistics (n, s a + 2 s) of state changes (n, T, s) under actions (T, a)."""
    with np.errstate(invalid="ignore", over="ignore"):  # of replays that diverged
        products = np.einsum("nts,ta->nsa", changes, actions) / len(actions)
        parts = [products.reshape(len(changes), -1), changes.mean(axis=1), changes.var(axis=1)]
    return np.concatenate(parts, axis=1)


def _starts(data: TransitionDataset, length: int | None) -> set[int]:
    """Rows at which a replay is set to the recorded state."""
    starts, first = set[int](), 0
    for episode in data.split():
        starts |= set(range(first, first + len(episode), length or len(episode)))
        first += len(episode)
    return starts


@dataclass(frozen=True)
class Scale:
    """Median and spread of simulated statistics, without those whose quartiles agree.

    Left out are constant statistics, and those that have one value in the whole middle half of the
    replays, though others differ.

    Replays of a robot that falls have statistics with long tails, so both are of quartiles, and
    the scaled statistics are compressed by arsinh, which grows as a logarithm.
    """

    median: Vector  # (k,)
    spread: Vector  # (k,) between the quartiles

    @classmethod
    def of(cls, simulated: Matrix) -> "Scale":
        """The scale of simulated statistics (n, k). Raises InvalidInput if none varies."""
        low, median, high = np.quantile(simulated, [0.25, 0.5, 0.75], axis=0)
        scale = cls(median, high - low)
        if not scale._varies.any():
            n, k = simulated.shape
            raise InvalidInput(
                f"no statistic of the replays depends on the parameters: in {n} replays, the "
                f"quartiles of each of {k} statistics agree; a recording is needed whose motion "
                "the parameters change"
            )
        return scale

    def __call__(self, statistics: Matrix) -> Matrix:
        """Statistics (..., k) as features for a network."""
        varies = self._varies
        return np.arcsinh((statistics[..., varies] - self.median[varies]) / self.spread[varies])

    @property
    def _varies(self) -> Mask:
        """Statistics (k,) whose quartiles differ by more than rounding."""
        return self.spread > 1e-12 * np.maximum(1.0, np.abs(self.median))


def outside(simulated: Matrix, recorded: Vector) -> int:
    """Statistics of the recording beyond those of all these simulations, which the model cannot do
    where they are of its whole search box."""
    return int(np.sum((recorded < simulated.min(axis=0)) | (recorded > simulated.max(axis=0))))

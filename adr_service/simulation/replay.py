"""Open-loop replay: recorded actions from recorded states, under other dynamics."""

import numpy as np

from adr_service.arrays import Array3, Matrix
from adr_service.simulation.batch import Simulations
from adr_service.tasks.base import Source, State, Task
from adr_service.transitions import TransitionDataset


class Replay:
    """Replays the windows of one dataset under any dynamics; built once per search.

    Windows have `length` control steps, do not overlap and never cross an episode.
    """

    def __init__(
        self,
        task: Task,
        source: Source,
        data: TransitionDataset,
        n: int,
        length: int,
        threads: int = 1,
    ):
        self._task, self._length = task, length
        self._starts = data.windows(length)
        self._states = task.state(data.observations[self._starts])
        self._actions = data.actions
        self._simulations = Simulations(task, source, n, threads)
        self.targets = data.next_observations[self._starts + length - 1]  # (w, s), measured

    def predict(self, dynamics: Matrix) -> Array3:
        """Predicted observations at each window's end, (n, w, s); NaN where diverged.

        Only the first state of a window is taken from the data.
        """
        simulations, n, measured = self._simulations, len(dynamics), self._task.measured
        simulations.set_dynamics(dynamics)
        predictions = np.empty((n, len(self._starts), self.targets.shape[1]))
        for window, start in enumerate(self._starts):
            qpos, qvel = self._states.qpos[window], self._states.qvel[window]
            simulations.set_state(State(qpos, qvel))
            for row in range(start, start + self._length):
                simulations.step(self._actions[row])
            predictions[:, window] = self._task.observe(simulations.state)[:, :measured]
        return predictions

    def mean_squared_error(self, dynamics: Matrix) -> np.ndarray:
        """Mean over windows of the squared L2 error of the prediction, (n,)."""
        errors = self.predict(dynamics) - self.targets
        return np.mean(np.sum(errors**2, axis=2), axis=1)

"""Open-loop replay: recorded actions from recorded states, under other dynamics."""

import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Batches, Simulations, control_period
from adr_service.tasks.base import Source, State, Task
from adr_service.transitions import TransitionDataset, unnamed

_ROUNDED = 1e-6  # of an action's range or of a column, what 32 bits may differ by
# Least gap between rows that do not follow one another, in changes of one step. Noise makes gaps of
# one change at most, but for chance. Every third row of a recording makes gaps of two, and rows in
# another order many more.
_LEAST_GAP = 1.5


class Replay:
    """Replays the windows of one dataset under any dynamics; built once per search.

    Windows have `length` control steps, do not overlap and never cross an episode. Raises
    InvalidInput for data of another robot, with shorter episodes, or whose rows do not follow one
    another (`check_replayable`).
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
        check_replayable(task, data, length)
        self._task, self._length = task, length
        self._starts = data.windows(length)
        if not len(self._starts):
            raise InvalidInput(f"no episode has {length} consecutive transitions: {data!r}")
        self._states = task.state(data.observations[self._starts])
        self._actions = data.actions
        self._batches = Batches(task, source, n, threads)
        self.targets = data.next_observations[self._starts + length - 1]  # (w, s), measured

    def predict(self, dynamics: Matrix) -> Array3:
        """Predicted observations at each window's end, (n, w, s); NaN where diverged.

        Only the first state of a window comes from the data. Any number of dynamics is
        simulated in batches of the constructor's `n`; the batch size changes no bit.
        """
        return self._batches.run(self._predict, dynamics)

    def _predict(self, simulations: Simulations) -> Array3:
        measured = self._task.measured
        predictions = np.empty((simulations.n, len(self._starts), self.targets.shape[1]))
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


def check_replayable(task: Task, data: TransitionDataset, length: int | None) -> None:
    """Raise InvalidInput if replays of `length` steps would not be replays of the recording.

    The data must be of this task's robot. Where a replay is longer than one step (None: a whole
    episode), the rows of an episode must follow one another: in no column may the next observations
    differ from the observations of the row after by much more than a step changes them (root mean
    squares over the recording). Noise on next observations alone, as DROPO's published recording
    has, stays below that.
    """
    check_recorded(task, data)
    if length != 1 and (gap := gap_of(data)) is not None:
        raise InvalidInput(
            f"replays longer than one step need rows that follow one another; {gap}. Give each "
            "stretch of rows that do an episode id of its own, or replay single steps (`steps` of "
            "dropo and sysid, or `segment` of bayes_sim and npdr: 1)"
        )


def gap_of(data: TransitionDataset) -> str | None:
    """A column in which the rows of an episode do not follow one another, and by how much; None if
    they do."""
    rows = np.flatnonzero(data.episodes[1:] == data.episodes[:-1])  # with a row after
    if not len(rows):
        return None
    after = data.next_observations[rows]
    gaps = _root_mean_square(after - data.observations[rows + 1])  # (s,)
    changes = _root_mean_square(after - data.observations[rows])
    rounding = _ROUNDED * np.max(np.abs(after), axis=0)
    apart = np.flatnonzero(gaps > np.maximum(_LEAST_GAP * changes, rounding))
    if not len(apart):
        return None
    column = int(apart[0])
    return (
        f"in {data.columns[column]}, next observations differ from the observations of the row "
        f"after by {gaps[column]:.3g}, where a step changes them by {changes[column]:.3g} (root "
        "mean squares)"
    )


def _root_mean_square(values: Matrix) -> Vector:
    return np.sqrt(np.mean(values**2, axis=0))


def check_recorded(task: Task, data: TransitionDataset) -> None:
    """Raise InvalidInput if the data are not of this task's robot."""
    _check_columns(task, data)
    _check_actions(task, data)
    period = control_period(task)
    if not np.isclose(data.dt, period, rtol=1e-6):
        raise InvalidInput(f"the data have {data.dt:g} s per step; {task.name} has {period:g} s")


def _check_columns(task: Task, data: TransitionDataset) -> None:
    given = (data.observations.shape[1], data.actions.shape[1])
    expected = (task.measured, len(task.action_low))
    if given != expected:
        raise InvalidInput(
            f"the data have {given[0]} observations and {given[1]} actions; {task.name} measures "
            f"{expected[0]} and takes {expected[1]}"
        )
    columns = task.columns[: task.measured]
    if data.columns not in (columns, tuple(unnamed(task.measured).tolist())):
        raise InvalidInput(
            f"the data's columns are {', '.join(data.columns)}; {task.name} measures "
            f"{', '.join(columns)}"
        )


def _check_actions(task: Task, data: TransitionDataset) -> None:
    slack = _ROUNDED * (task.action_high - task.action_low)
    beyond = np.maximum(task.action_low - data.actions, data.actions - task.action_high)
    outside = np.any(beyond > slack, axis=1)
    if outside.any():
        row = int(np.argmax(outside))
        raise InvalidInput(
            f"{int(outside.sum())} actions lie outside the bounds of {task.name}, the first at row "
            f"{row}: {data.actions[row].tolist()}; accepted: {task.action_low.tolist()} to "
            f"{task.action_high.tolist()}"
        )

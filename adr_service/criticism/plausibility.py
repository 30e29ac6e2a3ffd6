"""Checks of a measurement by itself: rows enough, sensors that move, velocities that are rates."""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.stats import theilslopes

from adr_service.arrays import Indices, Vector
from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput

_LEAST_EPISODES, _LEAST_TRANSITIONS = 8, 200
_STUCK = 0.2  # of all rows, with the very same extreme value
_ALIKE, _OFF = 0.5, 1.5  # correlation of positions' changes and velocities; their ratio
_WINDOW, _LEAST_WINDOWS, _MOST_WINDOWS = 10, 20, 500  # transitions of a window; how many to compare
_FOLLOWS, _SURE = 0.5, 0.999  # least slope of velocities that are of a joint, and of its interval
_SPACINGS = (1, 4)  # of rows, by which noise is measured: a filter leaves little from row to row
_CLEAR = 2.0  # standard deviations of noise: the median difference of displacements in clear motion


def check_usable(data: Measurement) -> None:
    """Raises InvalidInput for too few data to separate effects from noise, for a joint that never
    moves, and for a stuck sensor."""
    steps = int(np.sum(np.diff(data.episode) == 0))
    if steps < _LEAST_TRANSITIONS or len(data.spans()) < _LEAST_EPISODES:
        raise InvalidInput(
            f"{steps} transitions in {len(data.spans())} episodes are too few to tell effects "
            f"from noise; at least {_LEAST_TRANSITIONS} in {_LEAST_EPISODES} are needed "
            "(cut a long recording into episodes of about a second)"
        )

    is_still = (np.ptp(data.qpos, axis=0) == 0) & (np.ptp(data.qvel, axis=0) == 0)
    if is_still.any():
        column = int(np.argmax(is_still))
        raise InvalidInput(
            f"column {column} is constant in qpos ({data.qpos[0, column]:g}) and in qvel "
            f"({data.qvel[0, column]:g}): the joint never moves; needed are readings of one of the "
            "two that follow it, or else a model without the joint (weld it) and data without "
            "its columns"
        )
    both = (("qpos", data.qpos), ("qvel", data.qvel))
    shown = [(f"{name}, column {i},", v) for name, each in both for i, v in enumerate(each.T)]
    for (name, values), is_measured in zip(shown, data.is_measured(), strict=True):
        if is_measured and (why := why_stuck(values)) is not None:
            raise InvalidInput(
                f"{name} {why}; needed are readings that follow the robot (cut out rows in which "
                "it rests at the end of its range, and begin a new episode after each cut), or an "
                "infinite standard deviation (in an .npz) for what is not read"
            )


def check_rates(data: Measurement) -> None:
    """Raises InvalidInput unless velocities are the rates of the positions, by joint, and one
    of the two is measured."""
    inside = np.flatnonzero(np.diff(data.episode) == 0)
    measured, nv = data.is_measured(), data.qvel.shape[1]
    for column in range(nv):
        if not (measured[column] or measured[nv + column]):
            raise InvalidInput(
                f"column {column} is measured neither in qpos nor in qvel: both have an "
                "infinite standard deviation; needed is one of the two for each joint"
            )
        if not (measured[column] and measured[nv + column]):
            continue
        moved = data.qpos[inside + 1, column] - data.qpos[inside, column]
        mean = (data.qvel[inside + 1, column] + data.qvel[inside, column]) / 2
        expected = data.period() * mean
        alike = np.corrcoef(moved, expected)[0, 1] if np.any(expected) else 0.0
        if alike < -_ALIKE:
            raise InvalidInput(
                f"column {column} of qpos moves against the same column of qvel (their "
                f"correlation is {alike:.2f}): the sign of one of them is wrong, or the "
                "columns are not in the model's order"
            )
        if not alike >= _ALIKE:
            most = _most_slope(data, column)
            if most is not None and most < _FOLLOWS:
                raise InvalidInput(
                    f"column {column} of qpos moves, but not as the same column of qvel says (over "
                    f"{_WINDOW} transitions, {most:.2g} times as far as that at most): the columns "
                    "are not in the model's order, one of the two holds something else or is "
                    "late, or positions jump by a turn"
                )
            continue  # too little motion to judge by
        # noise of the one lessens the first ratio, of the other enlarges the second (Frisch, 1934)
        least = float(moved @ expected / (expected @ expected))
        most = float(moved @ moved / (moved @ expected))
        if least > _OFF or most < 1 / _OFF:
            ratio = least if least > _OFF else most
            raise InvalidInput(
                f"column {column} of qpos moves {ratio:.3g} times as far as the same column of "
                "qvel says; expected is about 1: `time` in seconds, positions and velocities "
                "both in rad or both in m, and columns in the model's order"
            )


def _most_slope(data: Measurement, column: int) -> float | None:
    """The largest slope of integrated velocities by displacements, over windows of an episode.

    Noise of velocities leaves the slope at 1, however much of it there is and however it is
    filtered. It is Theil and Sen's, by which a few outliers decide nothing, at the upper end of its
    interval. None unless displacements differ clearly more than the noise of positions makes them.
    """
    starts = np.concatenate([np.arange(a, b - _WINDOW, _WINDOW) for a, b in data.spans()])
    if len(starts) < _LEAST_WINDOWS:
        return None
    starts = starts[:: -(-len(starts) // _MOST_WINDOWS)]
    position, velocity = data.qpos[:, column], data.qvel[:, column]
    integral = cumulative_trapezoid(velocity, dx=data.period(), initial=0.0)
    displacement = position[starts + _WINDOW] - position[starts]
    expected = integral[starts + _WINDOW] - integral[starts]
    noise = max(_noise(position[::apart], data.episode[::apart]) for apart in _SPACINGS)
    if not np.median(np.abs(displacement - np.median(displacement))) > _CLEAR * np.sqrt(2) * noise:
        return None
    slopes = np.asarray(theilslopes(expected, displacement, _SURE), dtype=np.float64)
    return float(slopes[3])  # the upper end of the interval


def _noise(values: Vector, episode: Indices) -> float:
    """Standard deviation of the noise in readings (n,), by their third differences and their step.

    Fast motion counts as noise. Infinite where episodes are too short to tell.
    """
    third = np.diff(values, n=3)[episode[3:] == episode[:-3]]
    if not len(third):
        return np.inf
    step = np.min(np.diff(np.unique(values)), initial=np.ptp(values))
    # 20 = 1 + 9 + 9 + 1, the weights' squares
    return float(np.hypot(np.sqrt(np.mean(third**2) / 20), step / np.sqrt(12)))


def why_stuck(values: Vector) -> str | None:
    """The reason why a sensor's readings (n,) cannot be used; None if they can.

    Either they never change, or they saturate.
    """
    if np.ptp(values) == 0:
        return f"is {values[0]:g} in all rows"
    for most in (values.min(), values.max()):
        stuck = np.flatnonzero(values == most)
        if len(stuck) > _STUCK * len(values):
            share = f"{len(stuck)} of {len(values)} rows"
            return f"is saturated: {share} show {most:g}, and none goes beyond"
    return None

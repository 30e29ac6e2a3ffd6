"""The states of a recording without its sensors' noise, by a simulator with unknown parameters.

    smoothing = smooth(task, source, data)
    smoothing.data      # the recording, whose replays start from smoothed states

The criticism's fit estimates the parameters, the sensors' noise and the states together, and here
the parameters start from the middle of the prior. An extension of the offline methods: their papers
replay from the states as they were recorded (docs/decisions.md).
"""

from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from adr_service.arrays import Vector, frozen
from adr_service.criticism.compatibility import check_size, check_state
from adr_service.criticism.fits import fit, settled_there
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.probable_states import linearised
from adr_service.criticism.recordings import is_measured, measurement_of, observed
from adr_service.criticism.simulator import Simulator
from adr_service.progress import Progress, silent
from adr_service.simulation.model import compiled
from adr_service.simulation.replay import check_recorded
from adr_service.tasks.base import Source, Task
from adr_service.transitions import TransitionDataset

_ROUNDS = 4  # of smoothing, after which the parameters of the noisy tasks have settled
_UNREAD = 10.0  # deviation of a position that no sensor shows: so large that it says nothing
_FITTING = 20  # predictions of a round, besides its derivatives


@dataclass(frozen=True)
class Smoothing:
    """A recording with smoothed states, and what was estimated on the way."""

    data: TransitionDataset  # its observations are smoothed; next observations are as recorded
    parameters: Vector  # (d,) SI
    sensor_std: Vector  # (nq + nv,) of the noise in positions, then velocities; NaN: not measured
    simulated_steps: int  # control steps


def smooth(
    task: Task, source: Source, data: TransitionDataset, progress: Progress = silent
) -> Smoothing:
    """Estimate the noise in a recording, and take it out of the states.

    The strengths of a source's effects are estimated again, for the states alone. Raises
    InvalidInput for what `check_smoothable` and `data.check_chained` refuse, and for data that are
    not of this robot.
    """
    check_recorded(task, data)
    nominal, measurement = _nominal(task, source), measurement_of(task, data)
    model = nominal.model(nominal.start)
    check_size(model, measurement, kept=(2 * model.nv) ** 2)
    # the last digits of linear algebra depend on the number of threads
    with threadpool_limits(1), Simulator(nominal, measurement, threads=1) as simulator:
        sensor = np.where(is_measured(task), np.nan, _UNREAD**2)
        current = fit(simulator, sensor, source.effects)
        everywhere = np.ones(len(current.linear.residual))
        for number in range(1, _ROUNDS + 1):
            progress(number / (_ROUNDS + 1))
            current = settled_there(linearised(current, everywhere))
        states = current.states[simulator.starts]
    return Smoothing(
        replace(data, observations=observed(task, source, states)),
        frozen(current.parameters),
        frozen(np.where(is_measured(task), np.sqrt(current.noise.sensor), np.nan)),
        simulator.simulated_steps,
    )


def check_smoothable(task: Task) -> None:
    """Raises InvalidInput unless the state is positions and velocities of slides and hinges."""
    check_state(compiled(task.xml))


def planned_steps(task: Task, parameters: int, transitions: int) -> int:
    """Control steps that `smooth` simulates, about."""
    derivatives = 2 * (task.measured + 1) + parameters
    return (_ROUNDS + 1) * (derivatives + _FITTING) * transitions


def _nominal(task: Task, source: Source) -> Nominal:
    """The source, from the middle of the prior: what its file has may be the truth."""
    middle = (source.space.low + source.space.high) / 2
    return Nominal(task.xml, source.space, middle, source.fixed, task)

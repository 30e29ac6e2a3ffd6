"""Stand-ins for results, for plans: of the right form, and as different as their digests."""

import numpy as np

from adr_service.distributions import Gaussian
from adr_service.parameters import ParameterSpace
from adr_service.randomness import stream
from adr_service.simulation.batch import control_period
from adr_service.tasks.catalogue import get_task
from adr_service.transitions import TransitionDataset


def gaussian(space: ParameterSpace, digest: str) -> Gaussian:
    """A belief at a place of its own, too wide for a training to make it a point of a grid."""
    d = len(space)
    location = space.WIDTH * stream("stand-in", digest).random(d)
    return Gaussian(space, location, np.eye(d))


def trajectory(task_name: str, transitions: int, digest: str) -> bytes:
    """An `.npz` with so many transitions, in which nothing moves."""
    task = get_task(task_name)
    nothing = np.zeros((transitions, task.measured))
    return TransitionDataset(
        observations=nothing,
        actions=np.zeros((transitions, len(task.action_low))),
        next_observations=nothing,
        episodes=np.zeros(transitions, dtype=np.int64),
        dt=control_period(task),
        columns=task.columns[: task.measured],
        origin=f"stand-in {digest}",
    ).to_npz()

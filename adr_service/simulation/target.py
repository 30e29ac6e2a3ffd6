"""The simulated target: rollouts and evaluations under a task's hidden truth.

No method may import this module: the truth acts here, and stays here.
"""

from collections.abc import Callable

import numpy as np

from adr_service.arrays import Matrix
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations, control_period
from adr_service.simulation.rollout import Act, Episodes, run_episodes
from adr_service.tasks.base import Hidden, Task
from adr_service.tasks.catalogue import hidden_of
from adr_service.transitions import TransitionDataset


def simulate_rollout(
    task: Task, domain: str, act: Act, transitions: int, rng: np.random.Generator
) -> TransitionDataset:
    """One episode of `act` on the simulated target, clipped to `transitions`.

    Where the simulation diverges, the recording ends before that step.
    """
    hidden = hidden_of(task.name, domain)
    origin = f"simulated target {task.name} {domain}"
    return simulate_recording(task, hidden, act, transitions, rng, origin)


def simulate_recording(
    task: Task, hidden: Hidden, act: Act, transitions: int, rng: np.random.Generator, origin: str
) -> TransitionDataset:
    """`simulate_rollout` under any truth."""
    episode = _episodes(task, hidden, act, 1, transitions, rng)
    length = int(episode.lengths[0]) - int(episode.diverged[0])
    if length == 0:
        raise InvalidInput(f"the simulated target {task.name} diverged at its first step")
    observations = episode.observations[0, : length + 1]
    return TransitionDataset(
        observations=observations[:-1],
        actions=episode.actions[0, :length],
        next_observations=observations[1:],
        episodes=np.zeros(length, dtype=np.int64),
        dt=control_period(task),
        columns=task.columns[: task.measured],
        origin=origin,
    )


def simulate_evaluation(
    task: Task, domain: str, act: Act, episodes: int, rng: np.random.Generator
) -> Episodes:
    """Full episodes of `act` on the simulated target."""
    return _episodes(task, hidden_of(task.name, domain), act, episodes, task.horizon, rng)


def _episodes(
    task: Task, hidden: Hidden, act: Act, n: int, steps: int, rng: np.random.Generator
) -> Episodes:
    simulations = Simulations(task, hidden.source, n)
    simulations.set_dynamics(np.tile(hidden.values, (n, 1)))
    deviation, width = np.sqrt(hidden.noise_variance), task.measured

    def noise() -> Matrix:
        return deviation * rng.standard_normal((n, width))

    measured_with: Callable[[], Matrix] | None = noise if deviation > 0 else None
    return run_episodes(task, simulations, act, task.initial(n, rng), steps, measured_with)

"""Recordings for tests: published ones and our own."""

from pathlib import Path

import numpy as np

from adr_service.simulation.batch import Simulations, control_period
from adr_service.simulation.rollout import random_actions, run_episodes
from adr_service.tasks.catalogue import get_task, hidden_of
from adr_service.transitions import TransitionDataset

HOPPER_MASSES_KG = (3.53429174, 3.92699082, 2.71433605, 5.0893801)  # the authors' README


def load_hopper(folder: Path, prefix: str) -> TransitionDataset:
    """DROPO's Hopper transitions (gabrieletiboni/dropo, MIT licence)."""
    return TransitionDataset.from_npy(
        folder / prefix,
        dt=0.008,
        columns=get_task("hopper").columns,
        origin=f"gabrieletiboni/dropo {prefix}",
    )


def recording(name, steps, values=None):
    """An episode of small random actions, at the truth or at other `values`."""
    task, hidden, rng = get_task(name), hidden_of(name, "vanilla"), np.random.default_rng(0)
    simulations = Simulations(task, hidden.source, 1)
    simulations.set_dynamics(np.array(hidden.values if values is None else values)[None])
    random = random_actions(task, rng)

    def act(observations):
        return 0.2 * random(observations)

    episode = run_episodes(task, simulations, act, task.initial(1, rng), steps)
    n = int(episode.lengths[0])
    seen = episode.observations[0]
    return TransitionDataset(
        observations=seen[:n],
        actions=episode.actions[0, :n],
        next_observations=seen[1 : n + 1],
        episodes=np.zeros(n, dtype=np.int64),
        dt=control_period(task),
        columns=task.columns[: task.measured],
        origin="test",
    )

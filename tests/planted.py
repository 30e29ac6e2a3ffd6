"""An arm with planted dynamics, for methods to recover from recordings of a waving policy."""

from dataclasses import replace

import numpy as np

from adr_service.methods.base import Problem
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import run_episodes
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset

ARM = get_task("arm")
SOURCE = source_of("arm", "vanilla")
SPACE = SOURCE.space
PROBLEM = Problem(ARM, SOURCE)
PLANTED = np.array([1.6, 1.2, 3.0, 2.0])  # not the task's own truth


def waving_policy(seed=3, units=16):
    """A random network: it waves the arm about without turning it over at once."""
    rng = np.random.default_rng(seed)
    shapes = ((units, 4), (units, units), (2, units))
    layers = tuple(
        (rng.normal(0, 0.5, shape).astype(np.float32), np.zeros(shape[0], np.float32))
        for shape in shapes
    )
    return Policy(layers, "tanh", ARM.action_low, ARM.action_high)


def still_policy(task):
    """A policy whose action is always the middle of its range."""
    weights = np.zeros((len(task.action_low), len(task.columns)), dtype=np.float32)
    layers = ((weights, np.zeros(len(weights), dtype=np.float32)),)
    return Policy(layers, "tanh", task.action_low, task.action_high)


def recorded(policy, dynamics=PLANTED, episodes=1, steps=120, noise=0.0, seed=0):
    """Recordings of the policy on targets with these dynamics, (d,) or (episodes, d)."""
    rng = np.random.default_rng(seed)
    simulations = Simulations(ARM, SOURCE, episodes)
    simulations.set_dynamics(np.broadcast_to(dynamics, (episodes, 4)))
    draw = (lambda: noise * rng.standard_normal((episodes, 4))) if noise else None
    run = run_episodes(ARM, simulations, policy.act, ARM.initial(episodes, rng), steps, draw)
    return TransitionDataset.concatenate([_episode(run, row) for row in range(episodes)])


def stuck(data, column, value):
    """The recording with one sensor that always reads the same."""
    seen, seen_next = data.observations.copy(), data.next_observations.copy()
    seen[:, column] = seen_next[:, column] = value
    return replace(data, observations=seen, next_observations=seen_next)


def _episode(run, row):
    n = int(run.lengths[row])
    seen = run.observations[row, : n + 1]
    actions = run.actions[row, :n]
    episodes = np.zeros(n)
    return TransitionDataset(seen[:-1], actions, seen[1:], episodes, 0.02, ARM.columns, "planted")


def distance(mean, truth=PLANTED, space=SPACE):
    """Root mean square over the parameters, in [0, 4] coordinates; .91 for the arm's prior."""
    return np.sqrt(np.mean((space.normalise(mean) - space.normalise(truth)) ** 2))

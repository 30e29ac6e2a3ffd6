"""Closed-loop rollouts: episodes of a policy in many simulations at once."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Array3, Indices, Mask, Matrix, Vector
from adr_service.progress import Progress, silent
from adr_service.simulation.batch import Simulations
from adr_service.tasks.base import State, Task

Act = Callable[[Matrix], Matrix]  # observations (n, s) -> actions (n, a)


@dataclass(frozen=True)
class Episodes:
    """n episodes of at most T steps; rows after an episode's end are NaN."""

    observations: Array3  # (n, T + 1, s) measured columns, as the policy saw them
    actions: Array3  # (n, T, a)
    rewards: Matrix  # (n, T), 0 after the end
    lengths: Indices  # (n,) steps taken
    diverged: Mask  # (n,) the simulation stopped being finite

    @property
    def returns(self) -> Vector:
        """Undiscounted sums of rewards, (n,)."""
        return self.rewards.sum(axis=1)


def run_episodes(
    task: Task,
    simulations: Simulations,
    act: Act,
    initial: State,
    steps: int,
    noise: Callable[[], Matrix] | None = None,
) -> Episodes:
    """One episode of `steps` at most in each simulation, from `initial`.

    `noise` draws what the sensors add to each measurement (n, s). Reward and termination use
    the true state. A diverged simulation ends its episode; its last step earns nothing.
    """
    n, measured = simulations.n, task.measured
    # written step by step, read by simulation
    observations = np.empty((steps + 1, n, measured)).swapaxes(0, 1)
    actions = np.empty((steps, n, len(task.action_low))).swapaxes(0, 1)
    rewards = np.zeros((steps, n)).T
    alive = np.ones(n, dtype=bool)
    lengths = np.zeros(n, dtype=np.int64)
    diverged = np.zeros(n, dtype=bool)

    def seen(state: State) -> Matrix:
        columns = task.observe(state)
        if noise is not None:
            columns[:, :measured] += noise()
        return columns

    simulations.set_state(initial)
    state = simulations.state
    view = seen(state)
    observations[:, 0] = view[:, :measured]
    for step in range(steps):
        chosen = act(_shown(view, simulations))
        simulations.step(chosen)
        before, state = state, simulations.state
        broken = simulations.diverged & alive
        with np.errstate(invalid="ignore"):
            earned = task.reward(before, chosen, state)
            ended = task.terminated(state) | broken
        view = seen(state)
        actions[:, step], rewards[:, step] = chosen, earned
        observations[:, step + 1] = view[:, :measured]
        lengths += alive
        diverged |= broken
        alive &= ~ended
        if not alive.any():
            break
    over = np.arange(steps) >= lengths[:, None]
    observations[:, 1:][over], actions[over], rewards[over] = np.nan, np.nan, 0.0
    rewards[diverged, lengths[diverged] - 1] = 0.0
    return Episodes(observations, actions, rewards, lengths, diverged)


def random_actions(task: Task, rng: np.random.Generator) -> Act:
    """Actions (n, a), uniform within the task's bounds whatever is observed."""
    low, high = task.action_low, task.action_high
    return lambda observations: rng.uniform(low, high, (len(observations), len(low)))


def follow(
    task: Task,
    simulations: Simulations,
    act: Act,
    initial: State,
    steps: int,
    progress: Progress = silent,
) -> Array3:
    """Closed-loop measurements (n, steps + 1, s) that go on after a fall; NaN where diverged."""
    simulations.set_state(initial)
    observations = np.empty((simulations.n, steps + 1, task.measured))
    view = task.observe(simulations.state)
    observations[:, 0] = view[:, : task.measured]
    for step in range(steps):
        simulations.step(act(_shown(view, simulations)))
        view = task.observe(simulations.state)
        observations[:, step + 1] = view[:, : task.measured]
        progress((step + 1) / steps)
    return observations


def _shown(view: Matrix, simulations: Simulations) -> Matrix:
    """What a policy is given: zeros where the simulation has diverged."""
    return np.nan_to_num(view) if simulations.diverged.any() else view

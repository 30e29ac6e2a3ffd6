"""Closed-loop rollouts: episodes of a policy in many simulations at once.

episodes = run_episodes(task, simulations, policy.act, task.initial(n, rng), task.horizon)
episodes.returns                            # (n,)
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Array3, Indices, Mask, Matrix, Vector
from adr_service.errors import InvalidInput
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
    diverged: Mask  # (n,) true where the simulation diverged

    @property
    def returns(self) -> Vector:
        """Undiscounted sums of rewards, (n,)."""
        return self.rewards.sum(axis=1)


def random_actions(task: Task, rng: np.random.Generator) -> Act:
    """A policy that ignores observations: actions (n, a) uniform within the task's bounds."""
    low, high = task.action_low, task.action_high
    return lambda observations: rng.uniform(low, high, (len(observations), len(low)))


def run_episodes(
    task: Task,
    simulations: Simulations,
    act: Act,
    initial: State,
    steps: int,
    noise: Callable[[], Matrix] | None = None,
) -> Episodes:
    """Run one episode of at most `steps` steps in each simulation, from `initial`.

    `noise` draws the sensor noise of each measurement (n, s). Reward and termination use
    the true state. A diverged simulation ends its episode; its last step earns nothing.
    """
    log = _Log(task, simulations.n, steps)
    simulations.set_state(initial)
    state = simulations.state
    view = _observed(task, state, noise)
    log.start(view)
    for step in range(steps):
        actions = act(_without_nan(view, simulations))
        simulations.step(actions)
        before, state = state, simulations.state
        diverged = simulations.diverged
        with np.errstate(invalid="ignore"):
            rewards = task.reward(before, actions, state)
            ended = task.terminated(state) | diverged
        view = _observed(task, state, noise)
        log.add(step, actions, rewards, view, diverged)
        log.end(ended)
        if not log.alive.any():
            break
    return log.episodes()


def check_rewards(task: Task, rewards: np.ndarray) -> None:
    """Raise InvalidInput unless the rewards of simulations that have not diverged are finite."""
    finite = np.isfinite(rewards)
    if not finite.all():
        raise InvalidInput(
            f"the reward of {task.name} must be finite where the simulation has not diverged; it "
            f"was {rewards[~finite][0]}"
        )


class _Log:
    """The arrays of an `Episodes` while it is recorded."""

    def __init__(self, task: Task, n: int, steps: int):
        self._task, self._steps, self._measured = task, steps, task.measured
        # written step by step, read by simulation
        self._observations = np.empty((steps + 1, n, task.measured)).swapaxes(0, 1)
        self._actions = np.empty((steps, n, len(task.action_low))).swapaxes(0, 1)
        self._rewards = np.zeros((steps, n)).T
        self._lengths = np.zeros(n, dtype=np.int64)
        self._diverged = np.zeros(n, dtype=np.bool_)
        self.alive = np.ones(n, dtype=np.bool_)  # (n,) false after an episode's end

    def start(self, view: Matrix) -> None:
        self._observations[:, 0] = view[:, : self._measured]

    def add(
        self, step: int, actions: Matrix, rewards: Vector, view: Matrix, diverged: Mask
    ) -> None:
        self._actions[:, step], self._rewards[:, step] = actions, rewards
        self._observations[:, step + 1] = view[:, : self._measured]
        self._lengths += self.alive
        self._diverged |= diverged & self.alive

    def end(self, ended: Mask) -> None:
        self.alive &= ~ended

    def episodes(self) -> Episodes:
        observations, actions, rewards = self._observations, self._actions, self._rewards
        over = np.arange(self._steps) >= self._lengths[:, None]
        observations[:, 1:][over], actions[over], rewards[over] = np.nan, np.nan, 0.0
        rewards[self._diverged, self._lengths[self._diverged] - 1] = 0.0
        check_rewards(self._task, rewards)
        return Episodes(observations, actions, rewards, self._lengths, self._diverged)


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
        simulations.step(act(_without_nan(view, simulations)))
        view = task.observe(simulations.state)
        observations[:, step + 1] = view[:, : task.measured]
        progress((step + 1) / steps)
    return observations


def _observed(task: Task, state: State, noise: Callable[[], Matrix] | None) -> Matrix:
    """The policy's view of `state`, (n, columns), with noise on the measured columns."""
    columns = np.array(task.observe(state))  # perhaps the state itself
    if noise is not None:
        columns[:, : task.measured] += noise()
    return columns


def _without_nan(view: Matrix, simulations: Simulations) -> Matrix:
    """The view with zeros where the simulation has diverged, for policies need numbers."""
    return np.nan_to_num(view) if simulations.diverged.any() else view

"""One episode on a robot, and its trajectory."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.client.connection import Json
from adr_service.client.robot.environment import ROUNDED, Env, as_the_robots
from adr_service.client.robot.heart import Watch, now
from adr_service.client.robot.limits import Limits
from adr_service.errors import InvalidInput
from adr_service.npz import write_arrays
from adr_service.randomness import stream
from adr_service.transitions import TransitionDataset

_SLOW = 1.1  # times the control period, on average
_OF_RESET = ("observation", "info")
_OF_STEP = ("observation", "reward", "terminated", "truncated", "info")


@dataclass(frozen=True)
class Machine:
    """A robot with its name, the service's description of its task, and its owner's limits."""

    name: str
    env: Env
    about: Mapping[str, Any]
    limits: Limits


@dataclass(frozen=True)
class Episode:
    """A recorded episode of T transitions."""

    observations: Matrix  # (T + 1, s)
    actions: Matrix  # (T, a), as they were sent
    rewards: Vector  # (T,)
    limited: int  # actions that the owner's limit changed
    wrong: str = ""  # why the episode ended early, so that it has no return
    is_broken: bool = False  # because the robot showed what is no observation
    is_cut: bool = False  # the owner's time ended it, or the environment before its end
    is_whole: bool = False  # it has all its steps, or the task ended it
    period_s: float = np.nan  # mean time between two commands; NaN for fewer


def run_episode(
    machine: Machine,
    task: Json,
    act: Callable[[Matrix], Matrix],
    watch: Watch,
    why_stop: Callable[[], str],
) -> Episode:
    """Run a task's episode to its end, until something is wrong, or until it should stop."""
    rollout = Rollout(machine, watch, task["transitions"])
    if not why_stop():  # to reset is to move
        rollout.reset(seed_of(task))
    while not rollout.is_over and not why_stop():
        rollout.step(act)
    return rollout.episode()


class Rollout:
    """The observations, actions and rewards of an episode that goes on."""

    def __init__(
        self, machine: Machine, watch: Watch, transitions: int, *, has_rewards: bool = True
    ):
        """`has_rewards`: whether the environment's are recorded; otherwise they may be anything."""
        self._has_rewards = has_rewards
        self._machine, self._watch, self._transitions = machine, watch, transitions
        self._observations: list[Vector] = []
        self._actions: list[Vector] = []
        self._rewards: list[float] = []
        self._limited, self._wrong, self._ended, self._is_cut = 0, "", False, False
        self._is_broken = False
        self._began = now()
        self._sent: list[float] = []  # [s] when commands were sent

    @property
    def is_over(self) -> bool:
        return bool(self._wrong) or self._ended or self.is_complete

    @property
    def is_complete(self) -> bool:
        return len(self._actions) >= self._transitions

    def reset(self, seed: int) -> None:
        seconds = self._machine.limits.reset_seconds
        with self._watch.watching("reset", seconds), as_the_robots("reset"):
            answer = self._machine.env.reset(seed=seed)
        observation, _ = _parts(answer, _OF_RESET)
        self._observations.append(_row(observation))
        self._began = now()
        self._check(self._observations[0], 0.0)

    def step(self, act: Callable[[Matrix], Matrix]) -> None:
        passed = now() - self._began
        limits, seen = self._machine.limits, self._observations[-1]
        period = self._machine.about["control_period_s"]
        moved = (len(self._actions) + 1) * period
        if not limits.allows(max(moved, passed)):
            self._is_cut = True
            self._wrong = (
                f"{self._machine.name} may move for {limits.seconds:g} s (--max-seconds), and "
                "these are over"
            )
            return
        wanted = act(seen[None])[0]
        if not np.all(np.isfinite(wanted)):
            self._wrong = f"the policy's action is {wanted.tolist()} at {seen.tolist()}"
            return
        low, high = (np.array(self._machine.about[name]) for name in ("action_low", "action_high"))
        rounding = ROUNDED * np.maximum(np.abs(low), np.abs(high))
        if np.any((wanted < low - rounding) | (wanted > high + rounding)):
            self._wrong = f"the policy's action {wanted.tolist()} lies beyond the task's bounds"
            return
        bounded = np.clip(wanted, low, high)  # of what rounding alone put beyond
        action = limits.apply(bounded)
        self._limited += not np.array_equal(action, bounded)
        self._sent.append(now())
        with self._watch.watching("step", limits.left(passed, period)), as_the_robots("step"):
            answer = self._machine.env.step(action.copy())
        observation, reward, terminated, truncated, _ = _parts(answer, _OF_STEP)
        self._record(_row(observation), action, _number(reward) if self._has_rewards else 0.0)
        self._ended = terminated or truncated
        if truncated and not (terminated or self.is_complete or self._wrong):
            self._is_cut = True
            self._wrong = "the environment ended the episode early (truncated)"

    def _record(self, observation: Vector, action: Vector, reward: float) -> None:
        """Append a transition, unless something is wrong with its numbers."""
        self._check(observation, reward)
        if self._is_broken:
            return
        self._observations.append(observation)
        self._actions.append(action)
        self._rewards.append(reward)
        self._watch.steps = len(self._actions)

    def _check(self, observation: Vector, reward: float) -> None:
        """Note what is wrong with a transition's numbers, if anything is."""
        self._wrong = self._why_broken(observation, reward)
        self._is_broken = bool(self._wrong)

    def _why_broken(self, observation: Vector, reward: float) -> str:
        about = self._machine.about
        columns = about["observation_columns"]
        if observation.shape != (len(columns),):
            return (
                f"the robot showed an observation of shape {observation.shape}; {about['name']} "
                f"has {(len(columns),)}: {', '.join(columns)}"
            )
        if np.all(np.isfinite(observation)) and np.isfinite(reward):
            return ""
        return f"the robot showed {observation.tolist()} and the reward {reward}"

    def episode(self) -> Episode:
        return Episode(
            np.array(self._observations),
            np.array(self._actions),
            np.array(self._rewards),
            self._limited,
            self._wrong,
            self._is_broken,
            self._is_cut,
            self.is_over and not self._wrong,
            float(np.mean(np.diff(self._sent))) if len(self._sent) > 1 else np.nan,
        )


def _parts(answer: Any, names: tuple[str, ...]) -> tuple[Any, ...]:
    """The parts of an environment's answer; raises InvalidInput if these are not as many."""
    if isinstance(answer, tuple) and len(answer) == len(names):
        return answer
    size = f" of {len(answer)}" if isinstance(answer, tuple) else ""
    raise InvalidInput(
        f"the environment returned a {type(answer).__name__}{size}; Gymnasium's return a tuple of "
        f"{len(names)}: {', '.join(names)} (older Gym's had fewer)"
    )


def _number(reward: Any) -> float:
    try:
        return float(reward)
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"the environment's step returned the reward {reward!r}; needed is a number"
        ) from error


def to_npz(episode: Episode, about: Mapping[str, Any], origin: str) -> bytes:
    """Return the `.npz` that the service takes: the measured columns, and the rewards."""
    data = recording(episode, about, origin)
    return write_arrays({**data.to_arrays(), "rewards": episode.rewards})


def slowness(period_s: float, about: Mapping[str, Any]) -> str:
    """A remark if commands came more slowly than the recording will say, else nothing."""
    expected = about["control_period_s"]
    if not period_s > _SLOW * expected:
        return ""
    return (
        f"a step took {period_s:.3g} s on average, and counts as {expected:g} s: methods will take "
        f"the robot for {period_s / expected:.2g} times as fast as it is"
    )


def recording(episode: Episode, about: Mapping[str, Any], origin: str) -> TransitionDataset:
    """The measured columns of an episode with a transition."""
    measured = episode.observations[:, : about["measured_columns"]]
    return TransitionDataset(
        observations=measured[:-1],
        actions=episode.actions,
        next_observations=measured[1:],
        episodes=np.zeros(len(episode.actions), dtype=np.int64),
        dt=about["control_period_s"],
        columns=tuple(about["observation_columns"][: measured.shape[1]]),
        origin=origin,
    )


def random_actions(task: Json, about: Mapping[str, Any]) -> Callable[[Matrix], Matrix]:
    """Return a policy of uniform actions within the task's bounds."""
    low, high = np.array(about["action_low"]), np.array(about["action_high"])
    rng = stream("random actions", *_identity(task))

    def act(observations: Matrix) -> Matrix:
        return rng.uniform(low, high, (len(observations), len(low)))

    return act


def seed_of(task: Json) -> int:
    """Seed of an episode's reset: simulated environments use it, a robot ignores it."""
    return int(stream("robot", *_identity(task)).integers(2**31))


def _identity(task: Json) -> tuple[str, int, int]:
    """Facts of an episode that stay when it is run again; policies of one number share them."""
    return (task["kind"], task["number"], task["seed"])


def _row(observation: Any) -> Vector:
    try:
        # its own: a driver may fill one buffer again
        return np.array(observation, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"the environment showed the observation {observation!r}; needed is an array of numbers"
        ) from error

"""The Gymnasium environment that is the robot: how it is loaded, checked and closed."""

import importlib
import inspect
import signal
import sys
import threading
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

import gymnasium
import numpy as np

from adr_service.arrays import Vector
from adr_service.client.robot.heart import Watch
from adr_service.client.robot.limits import Limits
from adr_service.errors import AdrError, InvalidInput

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ROUNDED = 1e-6  # relative; bounds stored as float32 differ by so much

Env = gymnasium.Env[Any, Any]


def load_environment(path: str) -> Env:
    """Return the environment that `module:factory` makes; the working directory is searched too."""
    module, colon, factory = path.partition(":")
    if not colon or not module or not factory:
        raise InvalidInput(f"--env needs module:factory; given {path!r}")
    sys.path.insert(0, "")
    try:
        make: Any = getattr(importlib.import_module(module), factory)
    except (ImportError, AttributeError) as error:
        raise InvalidInput(f"{path} cannot be imported: {error}") from error
    if not callable(make):
        raise InvalidInput(
            f"{path} is a {type(make).__name__}; needed is a function or a class that makes the "
            "environment"
        )
    try:
        inspect.signature(make).bind()
    except TypeError as error:
        raise InvalidInput(f"{path} is called without arguments: {error}") from error
    with as_the_robots("creation"):
        env = make()
    if not isinstance(env, gymnasium.Env):
        raise InvalidInput(f"{path} makes a {type(env).__name__}; needed is a gymnasium.Env")
    return env


class RobotFailed(AdrError):
    """The robot's driver failed, or its observation is not finite or has the wrong shape."""

    code = "robot_failed"


@contextmanager
def as_the_robots(call: str) -> Generator[None]:
    """Raise RobotFailed for an OSError of the environment: else its driver's broken pipe looks like
    a closed output of ours, and ends the process without a word."""
    try:
        yield
    except OSError as error:
        raise RobotFailed(
            f"the environment's {call} failed, {type(error).__name__}: {error}; see to the robot"
        ) from error


class Closable(Protocol):
    def close(self) -> None: ...


@contextmanager
def closing_in_time(
    robot: Closable, seconds: float, hangs: Callable[[str], None]
) -> Generator[None]:
    """Close an environment, or what has one, after a block: if that takes longer than so many
    seconds, `hangs(reason)` is called from another thread."""
    try:
        yield
    finally:
        with (
            uninterrupted(),
            Watch(hangs).running() as watch,
            watch.watching("close", seconds),
            as_the_robots("close"),
        ):
            robot.close()


@contextmanager
def uninterrupted() -> Generator[None]:
    """Ignore what ends the process (Ctrl-C, SIGTERM, a terminal that closes) within a block.

    A `close` that parks a robot is not cut short. Only the main thread is ever interrupted.
    """
    with _handled_by(signal.SIG_IGN):
        yield


@contextmanager
def interrupted_later() -> Generator[None]:
    """Delay signals that end the process until a block has ended, such as one that writes an
    episode."""
    came: list[int] = []
    try:
        with _handled_by(lambda number, _: came.append(number)):
            yield
    finally:
        for number in came:  # a handler that raises ends this as well
            signal.raise_signal(number)


@contextmanager
def _handled_by(handler: Any) -> Generator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in _ENDING}
    try:
        yield
    finally:
        for number, former in before.items():
            if former is not None:  # else it is not Python's
                signal.signal(number, former)


def check_environment(
    env: Env, about: Mapping[str, Any], limits: Limits, asked: tuple[Vector, Vector] | None = None
) -> None:
    """Raise InvalidInput unless the environment fits the task, and the limits its actions.

    `asked`: least and largest (nu,) of the actions that will be asked for, None: the task's bounds.
    """
    given = (env.observation_space.shape, env.action_space.shape)
    needed = ((len(about["observation_columns"]),), (about["actions"],))
    if given != needed:
        raise InvalidInput(
            f"the environment has observations {given[0]} and actions {given[1]}; "
            f"{about['name']} has {needed[0]} and {needed[1]}"
        )
    if len(limits.actions) not in (0, 1, about["actions"]):
        raise InvalidInput(
            f"{len(limits.actions)} limits given for {about['actions']} actions; give one, or each"
        )
    if not all(0 < most < np.inf for most in limits.actions):
        raise InvalidInput(f"limits of actions must be positive; given {limits.actions}")
    low, high = np.array(about["action_low"]), np.array(about["action_high"])
    sent = [limits.apply(each) for each in asked or (low, high)]
    takes: Any = env.action_space  # of a Box; other spaces have no bounds
    beyond = [ROUNDED * np.abs(each) for each in sent]
    if isinstance(takes, gymnasium.spaces.Box) and (
        np.any(takes.low > sent[0] + beyond[0]) or np.any(takes.high < sent[1] - beyond[1])
    ):
        raise InvalidInput(
            f"the environment takes actions from {takes.low.tolist()} to {takes.high.tolist()}, "
            f"and would be sent {sent[0].tolist()} to {sent[1].tolist()}: limit them by "
            "--max-action, or widen its action_space"
        )
    nearest = limits.apply(np.clip(0.0, low, high))
    if np.any((nearest < low) | (nearest > high)):
        raise InvalidInput(
            f"within limits of {limits.actions} there is no action of {about['name']}, which takes "
            f"{low.tolist()} to {high.tolist()}"
        )

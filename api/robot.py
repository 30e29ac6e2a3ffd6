"""The client of a robot: runs the episodes that the service's runs wait for (docs/robots.md).

The robot is a Gymnasium environment: `reset` brings it to a start, `step` sends one command and
returns one control period later. It never acts beyond the limits that its owner gives here, and
stops within one control step once its lease is lost or its run was asked to stop.
"""

import importlib
import os
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.errors import InvalidInput, UnknownName
from adr_service.json_values import printable
from adr_service.npz import write_arrays
from adr_service.randomness import stream
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset
from api.client import AdrClient, Json, Refused, Unreachable

Env = gymnasium.Env[Any, Any]
_LONGEST_HEARTBEAT_S = 1.0  # between two
_RETRY_S = 2.0
_REQUEST_S = 60.0  # at most, but for heartbeats
_WAIT_S = 5.0  # for a task, by one request
_LONGEST_MESSAGE = 2000  # characters
_STEP_S = 60.0  # that a step may take, of milliseconds, before the environment hangs
_STOP_S = 10.0  # the same, once the episode should stop
_SLACK_S = 1.0  # beyond the owner's limit: the last step began within it


@dataclass(frozen=True)
class Limits:
    """What the owner of the robot allows, whatever a task asks for."""

    seconds: float | None = None  # of an episode, by the clock and by its steps
    reset_seconds: float = 120.0  # of bringing the robot to a start
    actions: tuple[float, ...] = ()  # largest magnitudes: one for all, or one for each; (): none

    def allows(self, seconds: float) -> bool:
        return self.seconds is None or seconds <= self.seconds

    def left(self, seconds: float) -> float:
        """For how long a step may take that begins `seconds` after the episode."""
        whole = _STEP_S if self.seconds is None else self.seconds - seconds + _SLACK_S
        return min(_STEP_S, whole)

    def apply(self, action: Vector) -> Vector:
        """The nearest action that is allowed."""
        if not self.actions:
            return action
        most = np.broadcast_to(np.array(self.actions), action.shape)
        return np.clip(action, -most, most)


@dataclass(frozen=True)
class Episode:
    """What happened; T transitions."""

    observations: Matrix  # (T + 1, s)
    actions: Matrix  # (T, a), as they were sent
    rewards: Vector  # (T,)
    limited: int  # actions that the owner's limit changed
    wrong: str = ""  # what ended it too early to count


class Robot:
    """Claims tasks and runs them, one after the other.

    `connect` makes a client whose requests end after so many seconds. Where the environment hangs,
    nothing can stop it in this process, so `abandon` ends that; it is called on another thread.
    """

    def __init__(
        self,
        connect: Callable[[float], AdrClient],
        task: str,
        environment: str,
        name: str,
        limits: Limits,
        report: Callable[[str], None],
        abandon: Callable[[], None] = lambda: os._exit(1),
    ):
        self._abandon = abandon
        self._connect, self._name, self._limits, self._report = connect, name, limits, report
        self._stopped = threading.Event()
        with connect(_REQUEST_S) as client:
            about = {known["name"]: known for known in self._patiently(client.tasks)}
        if task not in about:
            raise UnknownName("task", task, about)
        self._about = about[task]
        self._env = _environment(environment)
        _check(self._env, self._about, limits)

    def work(self, episodes: int | None = None) -> None:
        """Run tasks as they come; `episodes` of them, or without an end."""
        done, name = 0, self._about["name"]
        self._report(f"{self._name} waits for episodes of {name}")
        with closing(self._env), self._connect(_REQUEST_S) as self._client, suppress(_Stopped):
            while (episodes is None or done < episodes) and not self._stopped.is_set():
                claimed = self._patiently(
                    lambda: self._client.claim_task(self._name, [name], _WAIT_S)
                )
                if claimed is not None:
                    done += self._serve(claimed)

    def stop(self) -> None:
        """Stop within one control step, from any thread; the task goes back."""
        self._stopped.set()

    def _serve(self, claimed: Json) -> bool:
        """Run one task; whether its episode was accepted."""
        task, lease = claimed["task"], claimed["lease"]
        longest = task["transitions"] * self._about["control_period_s"]
        if task["kind"] != "rollout" and not self._limits.allows(longest):
            self._release(task, lease)  # another robot may have longer
            raise InvalidInput(
                f"{task['id']} asks for {longest:g} s, and this robot may move for "
                f"{self._limits.seconds:g}: allow --max-seconds {longest:g}, or submit runs of "
                "fewer transitions"
            )
        hangs = partial(self._give_up, task, lease)
        with _Heart(self._connect(claimed["lease_s"] / 3), claimed, hangs) as heart:
            try:
                episode = self._run(task, heart)
            except BaseException:  # whatever broke, the robot's owner must see to it
                self._release(task, lease)
                raise
            if why := self._why_stop(heart):
                self._report(f"{task['id']}: stopped, {why}")
                self._release(task, lease)
                return False
            return self._upload(task, lease, episode)

    def _run(self, task: Json, heart: "_Heart") -> Episode:
        act = self._actor(task)
        observations, actions, rewards = [], [], []
        limited, wrong, began = 0, "", time.monotonic()
        if not self._why_stop(heart):  # to reset is to move
            with heart.watching("reset", self._limits.reset_seconds):
                observation, _ = self._env.reset(seed=_seed(task))
            observations, began = [_row(observation)], time.monotonic()
            wrong = _broken(observations[0], 0.0)
        while len(actions) < task["transitions"] and not wrong and not self._why_stop(heart):
            moved = (len(actions) + 1) * self._about["control_period_s"]
            passed = time.monotonic() - began
            if not self._limits.allows(max(moved, passed)):
                wrong = f"{self._name} may move for {self._limits.seconds} s, which were over"
                break
            wanted = act(observations[-1][None])[0]
            if not np.all(np.isfinite(wanted)):
                wrong = f"the policy's action is {wanted.tolist()} at {observations[-1].tolist()}"
                break
            action = self._limits.apply(wanted)
            limited += not np.array_equal(action, wanted)
            with heart.watching("step", self._limits.left(passed)):
                observation, reward, ended, cut, _ = self._env.step(action)
            row = _row(observation)
            if wrong := _broken(row, float(reward)):
                break
            observations.append(row)
            actions.append(action)
            rewards.append(float(reward))
            heart.steps = len(actions)
            if ended or cut:
                break
        arrays = (np.array(observations), np.array(actions), np.array(rewards))
        return Episode(*arrays, limited, wrong)

    def _give_up(self, task: Json, lease: str, why: str) -> None:
        """The environment hangs: let others have the task, and end."""
        try:
            self._report(f"{task['id']}: {why}; see to the robot, and start this client again")
            with self._connect(_STOP_S) as client, suppress(Refused, Unreachable):
                client.release_task(task["id"], lease)  # else it is free when the lease ends
        finally:
            self._abandon()

    def _why_stop(self, heart: "_Heart") -> str:
        return heart.why_stop() or ("by its owner" if self._stopped.is_set() else "")

    def _actor(self, task: Json) -> Callable[[Matrix], Matrix]:
        if task["has_policy"]:
            content = self._patiently(lambda: self._client.content(task["links"]["policy"]))
            return Policy.from_bytes(content).act
        low, high = np.array(self._about["action_low"]), np.array(self._about["action_high"])
        rng = stream("random actions", *_names(task))
        return lambda observations: rng.uniform(low, high, (len(observations), len(low)))

    def _upload(self, task: Json, lease: str, episode: Episode) -> bool:
        if episode.wrong and (task["kind"] != "rollout" or not len(episode.actions)):
            self._fail(task, lease, episode.wrong)
            return False
        content = _trajectory(episode, self._about, self._name)
        try:
            self._patiently(lambda: self._client.complete_task(task["id"], lease, content))
        except Refused as error:
            if error.status == 409:
                self._report(f"{task['id']}: not accepted, {error}")
                return False
            if error.status >= 500:  # its defect, not the episode's
                self._release(task, lease)
                raise
            self._fail(task, lease, f"the service refused the episode: {error}")
            return False
        earned, steps = float(episode.rewards.sum()), len(episode.actions)
        note = f", {episode.limited} actions at the owner's limit" if episode.limited else ""
        note += f"; cut: {episode.wrong}" if episode.wrong else ""
        self._report(f"{task['id']}: {task['kind']}, {steps} steps, return {earned:.4g}{note}")
        return True

    def _fail(self, task: Json, lease: str, message: str) -> None:
        self._report(f"{task['id']}: {message}")
        try:
            told = printable(message)[:_LONGEST_MESSAGE]
            self._patiently(lambda: self._client.fail_task(task["id"], lease, told))
        except Refused as error:
            if error.status != 409:  # the task is not ours any more
                raise

    def _release(self, task: Json, lease: str) -> None:
        try:
            self._client.release_task(task["id"], lease)
        except (Refused, Unreachable):
            return  # it is free, or will be when the lease ends

    def _patiently(self, ask: Callable[[], Any]) -> Any:
        """The answer to a request, once the service is there and ready."""
        told = False
        while not self._stopped.is_set():
            try:
                return ask()
            except Refused as error:
                if error.retry_after_s is None:
                    raise
                self._stopped.wait(error.retry_after_s)
            except Unreachable as error:
                if not told:
                    self._report(str(error))
                told = True
                self._stopped.wait(_RETRY_S)
        raise _Stopped


class _Stopped(Exception):
    """The owner has stopped the robot while it waited for the service."""


class _Heart:
    """Beats while an episode goes on and the environment answers, and knows when it should stop.

    Calls `hangs(reason)`, once, if a `step` or a `reset` takes longer than it may.
    """

    def __init__(self, client: AdrClient, claimed: Json, hangs: Callable[[str], None]):
        self._hangs = hangs
        self._watched: tuple[str, float, float] | None = None  # what, since when, for how long
        self._client, self._task_id, self._lease = client, claimed["task"]["id"], claimed["lease"]
        self._lease_s: float = claimed["lease_s"]
        self._good_until = time.monotonic() + self._lease_s
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self.steps = 0
        self._why, self._stopped_at = "", 0.0

    @contextmanager
    def watching(self, what: str, seconds: float) -> Generator[None]:
        """Look after a call of the environment, which may take so long."""
        self._watched = (what, time.monotonic(), seconds)
        try:
            yield
        finally:
            self._watched = None

    def why_stop(self) -> str:
        """Why the episode should stop, where it should; never waits."""
        if not self._why and time.monotonic() > self._good_until:
            self._stop("the service did not answer for as long as the lease lasts")
        return self._why

    def _stop(self, why: str) -> None:
        self._why, self._stopped_at = why, time.monotonic()

    def __enter__(self) -> "_Heart":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _beat(self) -> None:
        with self._client:
            while not self._ended.wait(min(_LONGEST_HEARTBEAT_S, self._lease_s / 3)):
                if late := self._late():
                    self._stop(late)
                    self._hangs(late)
                    return
                if not self._why:
                    self._renew()

    def _late(self) -> str:
        """Why the environment is taken to hang, where it is."""
        if (watched := self._watched) is None:
            return ""
        what, since, seconds = watched
        now = time.monotonic()
        if now - since > seconds:
            return f"the environment's {what} did not return within {seconds:.1f} s"
        if self._why and what == "step" and now - max(since, self._stopped_at) > _STOP_S:
            return f"{self._why}, and the environment's {what} does not return"
        return ""

    def _renew(self) -> None:
        asked = time.monotonic()
        try:
            self._ask()
            self._good_until = asked + self._lease_s
        except Refused as error:
            if error.status == 409:
                self._stop(str(error))
        except Unreachable:
            pass  # until the lease ends, others cannot have the task
        except Exception as error:  # noqa: BLE001 - a robot must not move on without a heart
            self._stop(f"the service's answer is none: {error}")

    def _ask(self) -> None:
        """Say that the episode goes on, and hear whether it should."""
        answer = self._client.heartbeat(self._task_id, self._lease, self.steps)
        if answer["cancel_requested"]:
            self._stop("its run was asked to stop")


def _environment(path: str) -> Env:
    """The environment that `module:factory` makes; modules of the working directory count."""
    module, colon, factory = path.partition(":")
    if not colon or not module or not factory:
        raise InvalidInput(f"--env needs module:factory; given {path!r}")
    sys.path.insert(0, "")
    try:
        make: Any = getattr(importlib.import_module(module), factory)
    except (ImportError, AttributeError) as error:
        raise InvalidInput(f"{path} cannot be imported: {error}") from error
    env = make()
    if not isinstance(env, gymnasium.Env):
        raise InvalidInput(f"{path} makes a {type(env).__name__}; needed is a gymnasium.Env")
    return env


def _check(env: Env, about: Mapping[str, Any], limits: Limits) -> None:
    """Refuse an environment that is not of the task, or limits that are not of the environment."""
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


def _seed(task: Json) -> int:
    """For environments that are simulations; a robot does not care."""
    return int(stream("robot", *_names(task)).integers(2**31))


def _names(task: Json) -> tuple[str, int, int]:
    """What tells the episodes of a run apart."""
    return (task["kind"], task["number"], task["seed"])


def _row(observation: Any) -> Vector:
    return np.asarray(observation, dtype=np.float64)


def _broken(observation: Vector, reward: float) -> str:
    """What is wrong with what the sensors say."""
    if np.all(np.isfinite(observation)) and np.isfinite(reward):
        return ""
    return f"the robot showed {observation.tolist()} and the reward {reward}"


def _trajectory(episode: Episode, about: Mapping[str, Any], name: str) -> bytes:
    """The `.npz` that the service takes: what it measures, and the rewards."""
    measured = episode.observations[:, : about["measured_columns"]]
    data = TransitionDataset(
        observations=measured[:-1],
        actions=episode.actions,
        next_observations=measured[1:],
        episodes=np.zeros(len(episode.actions), dtype=np.int64),
        dt=about["control_period_s"],
        columns=tuple(about["observation_columns"][: measured.shape[1]]),
        origin=name,
    )
    return write_arrays({**data.to_arrays(), "rewards": episode.rewards})

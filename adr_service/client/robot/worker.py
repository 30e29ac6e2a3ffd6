"""The loop of a robot's client: it claims tasks and runs their episodes, one after the other."""

import os
import threading
from collections.abc import Callable
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

from adr_service.arrays import Matrix
from adr_service.client.connection import AdrClient, Json, Refused, Unreachable
from adr_service.client.robot.environment import check_environment, load_environment
from adr_service.client.robot.episode import Episode, Machine, random_actions, run_episode, to_npz
from adr_service.client.robot.heart import STOP_S, Heart
from adr_service.client.robot.limits import Limits
from adr_service.errors import InvalidInput, UnknownName
from adr_service.json_values import printable
from adr_service.training.policy import Policy

_RETRY_S = 2.0
_REQUEST_S = 60.0  # longest request, but for heartbeats
_LEEWAY = 1.2  # of an episode's time, for steps that take longer than they should
_WAIT_S = 5.0  # for a task, by one request
_LONGEST_MESSAGE = 2000  # characters


def _end_process() -> None:
    os._exit(1)


class Robot:
    """Claims tasks and runs them, one after the other.

    `connect` makes a client whose requests end after so many seconds. If the environment hangs,
    nothing can stop it in this process, so another thread calls `abandon`, which ends the process.
    """

    def __init__(
        self,
        connect: Callable[[float], AdrClient],
        task: str,
        environment: str,
        name: str,
        limits: Limits,
        report: Callable[[str], None],
        abandon: Callable[[], None] = _end_process,
    ):
        self._abandon = abandon
        self._connect, self._name, self._limits, self._report = connect, name, limits, report
        self._stopped = threading.Event()
        with connect(_REQUEST_S) as client:
            about = {known["name"]: known for known in self._patiently(client.tasks)}
        if task not in about:
            raise UnknownName("task", task, about)
        self._about = about[task]
        self._env = load_environment(environment)
        check_environment(self._env, self._about, limits)

    def work(self, episodes: int | None = None) -> None:
        """Run tasks as they come: `episodes` of them, or without an end."""
        done, name = 0, self._about["name"]
        self._report(f"{self._name} waits for episodes of {name}")
        with closing(self._env), self._connect(_REQUEST_S) as self._client, suppress(_Stopped):
            while (episodes is None or done < episodes) and not self._stopped.is_set():
                claim = partial(self._client.claim_task, self._name, [name], _WAIT_S)
                claimed = self._patiently(claim)
                if claimed is not None:
                    done += self._serve(claimed)

    def stop(self) -> None:
        """Stop within one control step, from any thread; the task goes back."""
        self._stopped.set()

    def _serve(self, claimed: Json) -> bool:
        """Run one task; True if the service accepted its episode."""
        task, lease = claimed["task"], claimed["lease"]
        self._refuse_longer_than_allowed(task, lease)
        hangs = partial(self._give_up, task, lease)
        with Heart(self._connect(claimed["lease_s"] / 3), claimed, hangs) as heart:
            why_stop = partial(self._why_stop, heart)
            machine = Machine(self._name, self._env, self._about, self._limits)
            try:
                episode = run_episode(machine, task, self._actor(task), heart.watch, why_stop)
            except BaseException:  # whatever broke, the robot's owner must see to it
                self._release(task, lease)
                raise
            if why := why_stop():
                self._report(f"{task['id']}: stopped, {why}")
                self._release(task, lease)
                return False
            return self._upload(task, lease, episode)

    def _refuse_longer_than_allowed(self, task: Json, lease: str) -> None:
        """Raise InvalidInput for a whole episode that takes longer than the robot may move."""
        longest = task["transitions"] * self._about["control_period_s"]
        if task["kind"] == "rollout" or self._limits.allows(longest):
            return
        self._release(task, lease)  # for a robot that may move longer
        raise InvalidInput(
            f"{task['id']} asks for {longest:g} s, and this robot may move for "
            f"{self._limits.seconds:g}: allow --max-seconds {_LEEWAY * longest:.3g}, or submit "
            "runs of fewer transitions"
        )

    def _give_up(self, task: Json, lease: str, why: str) -> None:
        """Release the task of an environment that hangs, and abandon the environment."""
        try:
            self._report(f"{task['id']}: {why}; see to the robot, and start this client again")
            with self._connect(STOP_S) as client, suppress(Refused, Unreachable):
                client.release_task(task["id"], lease)  # else it is free when the lease ends
        finally:
            self._abandon()

    def _why_stop(self, heart: Heart) -> str:
        return heart.why_stop() or ("by its owner" if self._stopped.is_set() else "")

    def _actor(self, task: Json) -> Callable[[Matrix], Matrix]:
        if not task["has_policy"]:
            return random_actions(task, self._about)
        content = self._patiently(partial(self._client.content, task["links"]["policy"]))
        return Policy.from_bytes(content).act

    def _upload(self, task: Json, lease: str, episode: Episode) -> bool:
        """Upload the trajectory; True if the service accepted it."""
        counts = task["kind"] != "rollout"
        if counts and episode.is_over_time:
            self._release(task, lease)  # for a robot that may move longer, or is faster
            raise InvalidInput(
                f"{task['id']}: {episode.wrong} after {len(episode.actions)} of "
                f"{task['transitions']} steps, whose return counts: allow more --max-seconds"
            )
        if episode.wrong and (counts or not len(episode.actions)):
            self._fail(task, lease, episode.wrong)
            return False
        content = to_npz(episode, self._about, self._name)
        try:
            self._patiently(partial(self._client.complete_task, task["id"], lease, content))
        except Refused as error:
            self._report_refusal(task, lease, error, content)
            return False
        except BaseException:  # its owner stopped it while the service was away
            self._keep(task, content)
            raise
        self._report_episode(task, episode)
        return True

    def _keep(self, task: Json, content: bytes) -> None:
        """Write an episode that the service does not have: a robot's work is dear."""
        file = Path(f"{task['id']}.npz").absolute()
        file.write_bytes(content)
        self._report(f"{task['id']}: the service does not have the episode; it is in {file}")

    def _report_refusal(self, task: Json, lease: str, error: Refused, content: bytes) -> None:
        """Report a refused trajectory, or raise the error if the service is to blame."""
        if error.status == 409:
            self._report(f"{task['id']}: not accepted, {error}")
        elif error.status >= 500:
            self._keep(task, content)
            self._release(task, lease)
            raise error
        else:
            self._fail(task, lease, f"the service refused the episode: {error}")

    def _report_episode(self, task: Json, episode: Episode) -> None:
        earned, steps = float(episode.rewards.sum()), len(episode.actions)
        note = f", {episode.limited} actions at the owner's limit" if episode.limited else ""
        note += f"; cut: {episode.wrong}" if episode.wrong else ""
        self._report(f"{task['id']}: {task['kind']}, {steps} steps, return {earned:.4g}{note}")

    def _fail(self, task: Json, lease: str, message: str) -> None:
        self._report(f"{task['id']}: {message}")
        short = printable(message)[:_LONGEST_MESSAGE]
        try:
            self._patiently(partial(self._client.fail_task, task["id"], lease, short))
        except Refused as error:
            if error.status != 409:  # the task is not ours any more
                raise

    def _release(self, task: Json, lease: str) -> None:
        try:
            self._client.release_task(task["id"], lease)
        except (Refused, Unreachable):
            return  # it is free, or will be when the lease ends

    def _patiently(self, ask: Callable[[], Any]) -> Any:
        """Return the answer to a request, once the service is there and ready."""
        has_reported = False
        while not self._stopped.is_set():
            try:
                return ask()
            except Refused as error:
                if error.retry_after_s is None:
                    raise
                self._stopped.wait(error.retry_after_s)
            except Unreachable as error:
                if not has_reported:
                    self._report(str(error))
                has_reported = True
                self._stopped.wait(_RETRY_S)
        raise _Stopped


class _Stopped(Exception):
    """The owner has stopped the robot while it waited for the service."""

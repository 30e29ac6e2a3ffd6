"""The loop of a robot's client: it claims tasks and runs their episodes, one after the other."""

import os
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from functools import partial
from typing import Any

from adr_service.arrays import Matrix
from adr_service.client.connection import AdrClient, Json
from adr_service.client.http import Refused, Unreachable
from adr_service.client.robot.environment import (
    RobotFailed,
    as_the_robots,
    check_environment,
    closing_in_time,
    interrupted_later,
    load_environment,
    uninterrupted,
)
from adr_service.client.robot.episode import (
    Episode,
    Machine,
    random_actions,
    run_episode,
    slowness,
    to_npz,
)
from adr_service.client.robot.heart import MOST_BEAT_S, STOP_S, Heart, Watch, now
from adr_service.client.robot.limits import Limits
from adr_service.client.robot.unsent_episodes import UnsentEpisode
from adr_service.errors import InvalidInput, UnknownName
from adr_service.json_values import printable
from adr_service.training.policy import Policy

_RETRY_S = 2.0
_REQUEST_S = 60.0  # longest request, but for heartbeats
# statuses of an episode that is not ours any more, that is no good, and of an unknown task: its run
# was deleted, or another service gave it
_LOST, _UNUSABLE, _UNKNOWN = 409, 422, 404
_DEFECT = 500  # and above: statuses that no request is to blame for
_FINAL = (_LOST, _UNUSABLE, _UNKNOWN)
_FACTS = (  # of a task, by which an environment is checked and an episode recorded
    *("observation_columns", "measured_columns", "actions"),
    *("action_low", "action_high", "control_period_s"),
)
_LEEWAY = 1.2  # of an episode's time, for steps that take longer than they should
_WAIT_S = 5.0  # for a task, by one request
_LONGEST_MESSAGE = 2000  # characters


def _end_process() -> None:
    os._exit(1)


class Robot:
    """Claims tasks and runs them, one after the other.

    `connect` makes a client whose requests end after so many seconds without an answer. If the
    environment hangs, nothing can stop it in this process, so another thread calls `abandon`, which
    ends the process.
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
        self._env, self._is_closed = load_environment(environment), False
        try:
            check_environment(self._env, self._about, limits)
        except BaseException:
            with self._closing():
                raise

    def work(self, episodes: int | None = None) -> None:
        """Run tasks as they come: `episodes` of them, or without an end.

        First it sends the episodes that an earlier client left in the working directory. However it
        ends, the environment is closed. Raises InvalidInput if it is closed already, and
        RobotFailed where the robot's driver or its sensors fail.
        """
        if self._is_closed:
            raise InvalidInput("this robot is closed; make another Robot")
        done, name = 0, self._about["name"]
        with self._closing(), self._connect(_REQUEST_S) as self._client, suppress(_Stopped):
            self._report(f"{self._name} waits for episodes of {name}")
            for left in UnsentEpisode.all_here():
                self._send_again(left)
            while (episodes is None or done < episodes) and not self._stopped.is_set():
                claim = partial(self._client.claim_task, self._name, [name], _WAIT_S)
                asked, claimed = self._patiently(
                    lambda claim=claim: (now(), claim()), through_defects=True
                )
                if claimed is not None:
                    done += self._serve(claimed, asked)

    def stop(self) -> None:
        """Stop within one control step, from any thread.

        The task goes back, unless its episode has ended: that one stays for the next client.
        """
        self._stopped.set()

    def close(self) -> None:
        """Close the environment, once."""
        if not self._is_closed:
            with uninterrupted(), as_the_robots("close"):
                self._is_closed = True
                self._env.close()

    def _closing(self) -> AbstractContextManager[None]:
        def hangs(why: str) -> None:
            try:
                self._report(f"{why}; see to the robot")
            finally:
                self._abandon()

        return closing_in_time(self, self._limits.reset_seconds, hangs)

    def _serve(self, claimed: Json, asked: float) -> bool:
        """Run one task; True if the service accepted its episode."""
        task, lease = claimed["task"], claimed["lease"]
        try:
            self._check_facts()
        except BaseException:  # also its owner, who stops it
            _release(self._client, task, lease)
            raise
        self._refuse_longer_than_allowed(task, lease)
        hangs = partial(self._give_up, task, lease)
        beats = self._connect(min(claimed["lease_s"] / 3, MOST_BEAT_S))
        with Heart(beats, claimed, asked, hangs) as heart:
            why_stop = partial(self._why_stop, heart)
            machine = Machine(self._name, self._env, self._about, self._limits)
            try:
                episode = run_episode(machine, task, self._actor(task), heart.watch, why_stop)
            except BaseException:  # whatever broke, the robot's owner must see to it
                self._close_and_release(task, lease, heart.watch)
                raise
            if (why := why_stop()) and not episode.is_whole:
                self._report(f"{task['id']}: stopped, {why}")
                _release(self._client, task, lease)
                return False
            return self._upload(task, lease, episode, heart.watch)

    def _check_facts(self) -> None:
        """Raise InvalidInput if the service has other facts of the task now, as after an upgrade.

        The environment was compared with those of this client's start, and may not fit the others.
        """
        tasks = {known["name"]: known for known in self._patiently(self._client.tasks)}
        before, here = self._about, tasks.get(self._about["name"], {})
        if changed := [name for name in _FACTS if here.get(name) != before[name]]:
            raise InvalidInput(
                f"the task {before['name']} has changed since this client started, in "
                f"{', '.join(changed)}: start the client again"
            )

    def _refuse_longer_than_allowed(self, task: Json, lease: str) -> None:
        """Raise InvalidInput for a whole episode that takes longer than the robot may move."""
        longest = task["transitions"] * self._about["control_period_s"]
        if task["kind"] == "rollout" or self._limits.allows(longest):
            return
        _release(self._client, task, lease)  # for a robot that may move longer
        raise InvalidInput(
            f"{task['id']} asks for {longest:g} s, and this robot may move for "
            f"{self._limits.seconds:g}: allow --max-seconds {_LEEWAY * longest:.3g}. An episode "
            "whose return counts has as many steps as its task"
        )

    def _close_and_release(self, task: Json, lease: str, watch: Watch) -> None:
        """Close the environment before anything that may wait, and give the task back."""
        try:
            with watch.watching("close", self._limits.reset_seconds):
                self.close()
        finally:
            with self._connect(STOP_S) as client:
                _release(client, task, lease)

    def _give_up(self, task: Json, lease: str, why: str) -> None:
        """Release the task of an environment that hangs, and abandon the environment."""
        try:
            self._report(f"{task['id']}: {why}; see to the robot, and start this client again")
            with self._connect(STOP_S) as client:
                _release(client, task, lease)
        finally:
            self._abandon()

    def _why_stop(self, heart: Heart) -> str:
        return heart.why_stop() or ("by its owner" if self._stopped.is_set() else "")

    def _actor(self, task: Json) -> Callable[[Matrix], Matrix]:
        if not task["has_policy"]:
            return random_actions(task, self._about)
        content = self._patiently(partial(self._client.content, task["links"]["policy"]))
        return Policy.from_bytes(content).act

    def _upload(self, task: Json, lease: str, episode: Episode, watch: Watch) -> bool:
        """Upload the trajectory; True if the service accepted it."""
        counts, steps = task["kind"] != "rollout", len(episode.actions)

        def leave(why: str) -> str:  # the task to a robot that can do all of it
            self._close_and_release(task, lease, watch)
            after = f"{task['id']}: {episode.wrong} after {steps} of {task['transitions']} steps"
            return f"{after}; {why}"

        if episode.is_broken:
            raise RobotFailed(leave("see to the robot"))
        if episode.is_cut and counts:
            raise InvalidInput(leave("their return counts"))
        if episode.is_cut and not steps:
            raise InvalidInput(leave("there is nothing to learn from"))
        if episode.wrong and (counts or not steps):
            self._fail(task, lease, episode.wrong)
            return False
        with interrupted_later():
            content = to_npz(episode, self._about, self._name)
            unsent = UnsentEpisode.written(task["id"], lease, content)
        if unsent.file is None:
            self._report(f"{task['id']}: no file can be written here, in case it cannot be sent")
        try:
            self._send(unsent)
        except Refused as error:
            if error.status not in _FINAL:
                raise
            self._report(f"{task['id']}: {self._client.url} did not accept it, {error}")
            if error.status == _UNUSABLE and episode.is_cut:
                raise InvalidInput(leave(str(error))) from error
            if error.status == _UNUSABLE:
                self._fail(task, lease, f"the service refused the episode: {error}")
            return False
        self._report_episode(task, episode)
        return True

    def _send(self, unsent: UnsentEpisode) -> None:
        """Upload an episode, whose file stays until the service has it.

        After a final answer it has a name of its own.
        """
        task_id, lease, content = unsent.task_id, unsent.lease, unsent.content
        try:
            self._patiently(partial(self._client.complete_task, task_id, lease, content))
        except BaseException as error:  # also its owner, who stops it while the service is away
            if isinstance(error, Refused) and error.status in _FINAL:
                unsent = unsent.set_aside()
            where = unsent.file or "no file, because none could be written"
            self._report(f"{task_id}: the service does not have the episode; it is in {where}")
            raise
        try:
            unsent.discard()
        except OSError as error:
            self._report(
                f"{task_id}: the service has the episode, but its file cannot be deleted: {error}"
            )

    def _send_again(self, unsent: UnsentEpisode) -> None:
        """Upload an episode that an earlier client left; raises Refused if it is still refused.

        Otherwise the robot would do the task again, and overwrite the episode.
        """
        left = f"{unsent.task_id}, left by an earlier client"
        try:
            self._send(unsent)
        except Refused as error:
            if error.status not in _FINAL:
                self._report(
                    f"{left}: this robot does nothing else until the service takes its episode, or "
                    f"you move {unsent.task_id}.npz and .lease to another folder"
                )
                raise
            self._report(f"{left}: {self._client.url} did not accept it, {error}")
        else:
            self._report(f"{left}: the service has its episode now")

    def _report_episode(self, task: Json, episode: Episode) -> None:
        earned, steps = float(episode.rewards.sum()), len(episode.actions)
        note = f", {episode.limited} actions at the owner's limit" if episode.limited else ""
        note += f"; cut: {episode.wrong}" if episode.wrong else ""
        if slow := slowness(episode.period_s, self._about):
            note += f"; {slow}"
        self._report(f"{task['id']}: {task['kind']}, {steps} steps, return {earned:.4g}{note}")

    def _fail(self, task: Json, lease: str, message: str) -> None:
        self._report(f"{task['id']}: {message}")
        short = printable(message)[:_LONGEST_MESSAGE]
        try:
            self._patiently(partial(self._client.fail_task, task["id"], lease, short))
        except Refused as error:
            if error.status != _LOST:
                raise

    def _patiently(self, ask: Callable[[], Any], *, through_defects: bool = False) -> Any:
        """Return the answer to a request, once the service is there and ready.

        `through_defects`: also where the service has a defect, which may be gone the next time.
        """
        has_reported = False
        while not self._stopped.is_set():
            try:
                return ask()
            except (Refused, Unreachable) as error:
                wait_s = error.retry_after_s if isinstance(error, Refused) else _RETRY_S
                if through_defects and isinstance(error, Refused) and error.status >= _DEFECT:
                    wait_s = wait_s or _RETRY_S
                if wait_s is None:
                    raise
                if not has_reported:
                    self._report(f"{error}; trying again until the service takes it")
                has_reported = True
                self._stopped.wait(wait_s)
        raise _Stopped


def _release(client: AdrClient, task: Json, lease: str) -> None:
    """Give a task back; where that fails, it is free when the lease ends."""
    with suppress(Refused, Unreachable):
        client.release_task(task["id"], lease)


class _Stopped(Exception):
    """The owner has stopped the robot while it waited for the service."""

"""The heartbeats of an episode."""

import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager

from adr_service.client.connection import AdrClient, Json, Refused, Unreachable

STOP_S = 10.0  # in which a step returns once the episode should stop, else the environment hangs
_LONGEST_HEARTBEAT_S = 1.0  # between two


class Heart:
    """Renews the lease while an episode goes on and the environment answers.

    It says when the episode should stop. It calls `hangs(reason)` once if a `step` or a `reset`
    takes too long.
    """

    def __init__(self, client: AdrClient, claimed: Json, hangs: Callable[[str], None]):
        self._hangs = hangs
        self._watched: tuple[str, float, float] | None = None  # name, start and longest time
        self._client, self._task_id, self._lease = client, claimed["task"]["id"], claimed["lease"]
        self._lease_s: float = claimed["lease_s"]
        self._good_until = time.monotonic() + self._lease_s
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self.steps = 0
        self._why, self._stopped_at = "", 0.0

    @contextmanager
    def watching(self, name: str, seconds: float) -> Generator[None]:
        """Watch a call of the environment that may take so long."""
        self._watched = (name, time.monotonic(), seconds)
        try:
            yield
        finally:
            self._watched = None

    def why_stop(self) -> str:
        """Return why the episode should stop, or nothing; never waits."""
        if not self._why and time.monotonic() > self._good_until:
            self._stop("the service did not answer for as long as the lease lasts")
        return self._why

    def _stop(self, why: str) -> None:
        self._why, self._stopped_at = why, time.monotonic()

    def __enter__(self) -> "Heart":
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
        """Return why the environment hangs, or nothing."""
        if (watched := self._watched) is None:
            return ""
        name, since, seconds = watched
        now = time.monotonic()
        if now - since > seconds:
            return f"the environment's {name} did not return within {seconds:.1f} s"
        if self._why and name == "step" and now - max(since, self._stopped_at) > STOP_S:
            return f"{self._why}, and the environment's {name} does not return"
        return ""

    def _renew(self) -> None:
        asked = time.monotonic()
        try:
            self._send()
            self._good_until = asked + self._lease_s
        except Refused as error:
            if error.status == 409:
                self._stop(str(error))
        except Unreachable:
            pass  # until the lease ends, others cannot have the task
        except Exception as error:  # noqa: BLE001 - a robot must not move on without a heart
            self._stop(f"the answer to a heartbeat cannot be read: {error}")

    def _send(self) -> None:
        """Report the steps so far, and stop if the run is cancelled."""
        answer = self._client.heartbeat(self._task_id, self._lease, self.steps)
        if answer["cancel_requested"]:
            self._stop("its run was asked to stop")

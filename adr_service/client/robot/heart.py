"""The heartbeats of an episode, and the watch over the calls of its environment."""

import threading
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from typing import Self

from adr_service.client.connection import AdrClient, Json, Refused, Unreachable

STOP_S = 10.0  # in which a step returns once the episode should stop, else the environment hangs
_LONGEST_BEAT_S = 1.0  # between two looks at the clock


class Watch:
    """Calls `hangs(reason)` once, from a thread of its own, if a `step` or a `reset` of an
    environment takes too long: nothing can end that call in this process.

    The thread also calls `beat` every `beat_s` seconds, and `late(name, since)` may know another
    reason why a call that began then takes too long.
    """

    def __init__(
        self,
        hangs: Callable[[str], None],
        beat_s: float = _LONGEST_BEAT_S,
        beat: Callable[[], None] = lambda: None,
        late: Callable[[str, float], str] = lambda name, since: "",
    ):
        self._hangs, self._beat, self._late = hangs, beat, late
        self._beat_s = min(_LONGEST_BEAT_S, beat_s)
        self._watched: tuple[str, float, float] | None = None  # name, start and longest time
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.steps = 0  # of the episode so far

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    @contextmanager
    def watching(self, name: str, seconds: float) -> Generator[None]:
        """Watch a call of the environment that may take so long."""
        self._watched = (name, time.monotonic(), seconds)
        try:
            yield
        finally:
            self._watched = None

    def _run(self) -> None:
        while not self._ended.wait(self._beat_s):
            if why := self._why_hanging():
                self._hangs(why)
                return
            self._beat()

    def _why_hanging(self) -> str:
        """Return why the environment hangs, or nothing."""
        if (watched := self._watched) is None:
            return ""
        name, since, seconds = watched
        if time.monotonic() - since > seconds:
            return f"the environment's {name} did not return within {seconds:.1f} s"
        return self._late(name, since)


class Heart:
    """Renews the lease while an episode goes on and the environment answers, and says when the
    episode should stop."""

    def __init__(self, client: AdrClient, claimed: Json, hangs: Callable[[str], None]):
        def stop(why: str) -> None:
            self._stop(why)
            hangs(why)

        self._client, self._task_id, self._lease = client, claimed["task"]["id"], claimed["lease"]
        self._lease_s: float = claimed["lease_s"]
        self.watch = Watch(stop, self._lease_s / 3, self._beat, self._late)
        self._good_until = time.monotonic() + self._lease_s
        self._why, self._stopped_at = "", 0.0
        self._open = ExitStack()

    def why_stop(self) -> str:
        """Return why the episode should stop, or nothing; never waits."""
        if not self._why and time.monotonic() > self._good_until:
            self._stop("the service did not answer for as long as the lease lasts")
        return self._why

    def _stop(self, why: str) -> None:
        self._why, self._stopped_at = why, time.monotonic()

    def __enter__(self) -> Self:
        self._open.enter_context(self._client)
        self._open.enter_context(self.watch)
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def _late(self, name: str, since: float) -> str:
        if not self._why or name != "step":
            return ""
        is_late = time.monotonic() - max(since, self._stopped_at) > STOP_S
        return f"{self._why}, and the environment's {name} does not return" if is_late else ""

    def _beat(self) -> None:
        if not self._why:
            self._renew()

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
        answer = self._client.heartbeat(self._task_id, self._lease, self.watch.steps)
        if answer["cancel_requested"]:
            self._stop("its run was asked to stop")

"""The heartbeats of an episode, and the watch over the calls of its environment.

Each has a thread of its own, so that a network that stalls does not blind the watch. Both measure
time by a clock that goes on while the computer is suspended: a lease does too.
"""

import threading
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Self

from adr_service.client.connection import AdrClient, Json
from adr_service.client.http import Refused, Unreachable

STOP_S = 10.0  # in which a step returns once the episode should stop, else the environment hangs
MOST_BEAT_S = 5.0  # that a heartbeat waits for its answer
_LOOK_S = 0.5  # between two looks at the clock
_LONGEST_PAUSE_S = 1.0  # between two heartbeats

now = partial(time.clock_gettime, time.CLOCK_BOOTTIME)  # [s]


class Watch:
    """Calls `hangs(reason)` once, from a thread of its own, if a `step` or a `reset` of an
    environment takes too long: nothing can end that call in this process.

    `late(name, since)` may know another reason why a call that began then takes too long.
    """

    def __init__(
        self,
        hangs: Callable[[str], None],
        late: Callable[[str, float], str] = lambda name, since: "",
    ):
        self._hangs, self._late = hangs, late
        self._watched: tuple[str, float, float] | None = None  # name, start and longest time
        self.steps = 0  # of the episode so far

    @contextmanager
    def running(self) -> Generator[Self]:
        with _repeating(self._look, _LOOK_S):
            yield self

    @contextmanager
    def watching(self, name: str, seconds: float) -> Generator[None]:
        """Watch a call of the environment that may take so long."""
        self._watched = (name, now(), seconds)
        try:
            yield
        finally:
            self._watched = None

    def _look(self) -> bool:
        """Look once; True if there is something to look for later."""
        if why := self._why_hanging():
            self._hangs(why)
        return not why

    def _why_hanging(self) -> str:
        """Return why the environment hangs, or nothing."""
        if (watched := self._watched) is None:
            return ""
        name, since, seconds = watched
        if now() - since > seconds:
            return f"the environment's {name} did not return within {seconds:.1f} s"
        return self._late(name, since)


class Heart:
    """Renews the lease while an episode goes on and the environment answers, and says when the
    episode should stop.

    `asked` is when the claim was sent, by this file's clock: a lease begins no earlier. A first
    heartbeat is sent before anything moves, and its answer, if there is one, decides whether it
    does.
    """

    def __init__(
        self, client: AdrClient, claimed: Json, asked: float, hangs: Callable[[str], None]
    ):
        def stop(why: str) -> None:
            self._stop(why)
            hangs(why)

        self._client, self._task_id, self._lease = client, claimed["task"]["id"], claimed["lease"]
        self._lease_s: float = claimed["lease_s"]
        self.watch = Watch(stop, self._late)
        self._good_until = asked + self._lease_s
        self._why, self._stopped_at = "", 0.0
        self._open = ExitStack()

    def why_stop(self) -> str:
        """Return why the episode should stop, or nothing; never waits."""
        if not self._why and now() > self._good_until:
            self._stop("the service did not answer for as long as the lease lasts")
        return self._why

    def _stop(self, why: str) -> None:
        if not self._why:
            self._stopped_at = now()  # first: the watch reads both
            self._why = why

    def __enter__(self) -> Self:
        self._open.enter_context(self._client)
        if self._renew():
            pause_s = min(_LONGEST_PAUSE_S, self._lease_s / 3)
            self._open.enter_context(_repeating(self._renew, pause_s))
        self._open.enter_context(self.watch.running())
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def _late(self, name: str, since: float) -> str:
        if not self._why or name != "step":
            return ""
        is_late = now() - max(since, self._stopped_at) > STOP_S
        return f"{self._why}, and the environment's {name} does not return" if is_late else ""

    def _renew(self) -> bool:
        """Send a heartbeat, unless there is a reason to stop; True if there is a next one."""
        if self._why:
            return False
        asked = now()
        try:
            self._send()
            self._good_until = asked + self._lease_s
        except Refused as error:
            if error.status < 500 and error.retry_after_s is None:
                self._stop(str(error))
        except Unreachable:
            pass  # until the lease ends, others cannot have the task
        except Exception as error:  # noqa: BLE001 - a robot must not move on without a heart
            self._stop(f"the answer to a heartbeat cannot be read: {error}")
        return not self._why

    def _send(self) -> None:
        """Report the steps so far, and stop if the run is cancelled."""
        answer = self._client.heartbeat(self._task_id, self._lease, self.watch.steps)
        if answer["cancel_requested"]:
            self._stop("its run was asked to stop")


@contextmanager
def _repeating(do: Callable[[], bool], pause_s: float) -> Generator[None]:
    """Call a function every `pause_s` seconds, in a thread, until it returns False."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(pause_s) and do():
            pass

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()

"""Virtual time, in which things happen when they are due."""

import heapq
import itertools
from collections.abc import Callable

_FIRST_STRIDE_S, _LONGEST_STRIDE_S = 0.05, 20.0


class Clock:
    """Seconds since the beginning of a schedule, and what is to happen."""

    def __init__(self) -> None:
        self.now = 0.0
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._stride = _FIRST_STRIDE_S

    def epoch_now(self) -> float:
        """The present, for `time.monotonic` and `time.time`."""
        return epoch(self.now)

    def after(self, seconds: float, action: Callable[[], None]) -> None:
        """Let something happen in so many seconds."""
        heapq.heappush(self._due, (self.now + seconds, next(self._numbers), action))

    def advance(self) -> None:
        """Go on by a tick, or to what happens next; in longer and longer strides without events."""
        until = self.now + _FIRST_STRIDE_S
        if not self._due or self._due[0][0] > until:
            until = self.now + self._stride
            self._stride = min(8 * self._stride, _LONGEST_STRIDE_S)
            if self._due:
                until = min(until, self._due[0][0])
        while self._due and self._due[0][0] <= until:
            self.now, _, action = heapq.heappop(self._due)
            self._stride = _FIRST_STRIDE_S
            action()
        self.now = until


def epoch(now: float) -> float:
    """A time of the clock as `time.time` gives it."""
    return 1_000_000.0 + now

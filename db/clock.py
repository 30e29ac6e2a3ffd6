"""Time for leases.

clock = SteadyClock()
clock.now()
"""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta


def _wall() -> datetime:
    return datetime.now(UTC)


class SteadyClock:
    """UTC time that advances evenly while this process lives, even if the wall clock is set.

    It starts at the wall clock's time, the only clock that two processes share.
    """

    def __init__(
        self,
        wall: Callable[[], datetime] = _wall,
        steady: Callable[[], float] = time.monotonic,
    ):
        self._steady = steady
        self._began, self._since = wall(), steady()

    def now(self) -> datetime:
        """The time, in UTC."""
        return self._began + timedelta(seconds=self._steady() - self._since)

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
    """UTC time that advances evenly while this process lives, also where the wall clock is set.

    It starts at the wall clock's time, which is all that two processes have in common.
    """

    def __init__(
        self,
        wall: Callable[[], datetime] = _wall,
        steady: Callable[[], float] = time.monotonic,
    ):
        self._steady = steady
        self._began, self._since = wall(), steady()

    def now(self) -> datetime:
        return self._began + timedelta(seconds=self._steady() - self._since)

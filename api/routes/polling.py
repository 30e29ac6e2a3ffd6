"""Requests that wait for a change: the database is asked again and again for a while."""

import time
from collections.abc import AsyncIterator

import anyio

EVERY_S = 0.25


async def looks(seconds: float) -> AsyncIterator[int]:
    """Count from 0 at once, then every quarter of a second until `seconds` have passed."""
    end, number = time.monotonic() + seconds, 0
    while True:
        yield number
        if time.monotonic() >= end:
            return
        number += 1
        await anyio.sleep(EVERY_S)

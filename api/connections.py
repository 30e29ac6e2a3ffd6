"""Connections: how many there may be at once, and how long a client may keep one waiting.

    uvicorn.run(app, http=bounded(connections_allowed(settings.max_connections)))

A connection takes a descriptor (an open file) of the process, and Ray and the database need theirs.
So connections are limited. Beyond the limit the one that has been idle for longest is closed, and
where none is idle the new one is refused with 503. Uvicorn itself waits for a request for ever.
"""

import asyncio
import resource
from collections.abc import Iterator
from functools import partial
from itertools import count
from typing import Any, cast

from uvicorn.protocols.http.h11_impl import H11Protocol

_KEPT = 512  # descriptors for Ray, the database, logs and files
_MOST = 1_000  # connections, however many descriptors there are
_RAISED_TO = 65_536  # descriptors, where the system lets us have as many
_SECONDS = {"head": 20.0, "body": 600.0}  # for the headers of a request, and for all of its body
_STALLED_S = 60.0  # for a client that does not read its answer
_REFUSAL = (
    b"HTTP/1.1 %s\r\nContent-Length: 0\r\nRetry-After: 5\r\nConnection: close\r\n\r\n"  # no app yet
)


def connections_allowed(given: int | None = None) -> int:
    """How many connections to accept: what was given, or what the descriptors allow."""
    return min(_MOST, max(_descriptors() - _KEPT, _KEPT // 8)) if given is None else given


def _descriptors() -> int:
    """The number of descriptors that this process may have, raised as far as that goes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = resource.RLIM_INFINITY
    wanted = _RAISED_TO if hard == unlimited else min(hard, _RAISED_TO)
    if soft != unlimited and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        return wanted
    return _RAISED_TO if soft == unlimited else soft


def bounded(most: int) -> type[asyncio.Protocol]:
    """Uvicorn's HTTP/1.1 for at most so many connections at once."""
    return cast("type[asyncio.Protocol]", partial(_Bounded, most, count()))


class _Bounded(H11Protocol):
    """Overrides what uvicorn calls, and adds one clock: for what the client owes."""

    def __init__(self, most: int, turns: Iterator[int], *given: Any, **named: Any):
        super().__init__(*given, **named)
        self._most, self._turns = most, turns
        self._turn = next(turns)  # when it became idle, among all
        self._owed = ""
        self._clock: asyncio.TimerHandle | None = None
        self._stalled: asyncio.TimerHandle | None = None

    @property
    def is_idle(self) -> bool:
        return self.cycle is None or self.cycle.response_complete  # pyright: ignore[reportUnnecessaryComparison]

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        super().connection_made(transport)
        self._watch()
        if len(self.connections) > self._most:
            others = [c for c in self.connections if isinstance(c, _Bounded) and c is not self]
            idle = [c for c in others if c.is_idle and not c.transport.is_closing()]
            # first who has never asked for anything
            victim = min(idle, key=lambda c: (c.cycle is not None, c._turn), default=self)  # pyright: ignore[reportUnnecessaryComparison]
            if victim.cycle is None:  # pyright: ignore[reportUnnecessaryComparison]
                victim.refuse(b"503 Service Unavailable")
            else:  # it had its answers, and would take this for the next one
                victim.transport.close()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._turn = next(self._turns)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        for clock in (self._clock, self._stalled):
            if clock is not None:
                clock.cancel()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._stalled = self.loop.call_later(_STALLED_S, self.transport.abort)

    def resume_writing(self) -> None:
        super().resume_writing()
        if self._stalled is not None:
            self._stalled.cancel()

    def refuse(self, status: bytes) -> None:
        """Close an idle connection, with the reason for a client that waits for an answer."""
        self.transport.write(_REFUSAL % status)
        self.transport.close()

    def _watch(self) -> None:
        """Start, keep or stop the clock for what the client owes."""
        if not self.is_idle:
            owed = "body" if self.cycle.more_body else ""
        else:  # between requests, uvicorn's own clock runs until the first byte
            owed = "head" if self.cycle is None or self.conn.trailing_data[0] else ""  # pyright: ignore[reportUnnecessaryComparison]
        if owed == self._owed:
            return
        self._owed = owed
        if self._clock is not None:
            self._clock.cancel()
        self._clock = self.loop.call_later(_SECONDS[owed], self._late) if owed else None

    def _late(self) -> None:
        if self.is_idle:
            self.refuse(b"408 Request Timeout")
        else:
            self.transport.abort()

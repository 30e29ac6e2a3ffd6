"""Connections: a limit on their number, and on the time that a client may keep one waiting.

    server = uvicorn.Config(app, http=bounded(connections_allowed(settings.max_connections)))

A connection takes a descriptor (an open file) of the process, and Ray and the database need
descriptors too. So connections are limited. Beyond the limit, the connection that has been idle for
longest is closed; if none is idle, the new one is refused with 503. Uvicorn by itself waits for a
request for ever.
"""

import asyncio
import logging
import resource
from collections.abc import Iterator
from functools import partial
from itertools import count
from typing import Any, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from api.errors import problem
from api.guard import protect

log = logging.getLogger(__name__)
_KEPT = 512  # descriptors for Ray, the database, logs and files
_MOST = 1_000  # connections, however many descriptors there are
_RAISED_TO = 65_536  # descriptors, where the system lets us have as many
_SECONDS = {"head": 20.0, "body": 600.0}  # for the headers of a request, and for its body
_ENOUGH_BYTES = 60_000_000  # of a body in that time, for which it gets as much again
_STALLED_S = 60.0  # in which a client must read some of its answer
_REFUSAL = (
    b"HTTP/1.1 %s\r\nContent-Length: 0\r\nRetry-After: 5\r\nConnection: close\r\n\r\n"  # no app yet
)


def connections_allowed(given: int | None = None) -> int:
    """Return the number of connections to accept: the given one, or as the descriptors allow."""
    possible = max(_descriptors() - _KEPT, _KEPT // 8)
    if given is not None and given > possible:
        log.warning(
            "ADR_MAX_CONNECTIONS is %d; the limit on open files (ulimit -Hn) allows %d, beside "
            "those of Ray and the database",
            given,
            possible,
        )
    return min(possible, _MOST if given is None else given)


def _descriptors() -> int:
    """Raise this process's limit on descriptors as far as possible, and return it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = resource.RLIM_INFINITY
    wanted = _RAISED_TO if hard == unlimited else min(hard, _RAISED_TO)
    if soft != unlimited and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        return wanted
    return _RAISED_TO if soft == unlimited else soft


def bounded(most: int) -> type[asyncio.Protocol]:
    """Return uvicorn's HTTP/1.1 protocol with a limit on the connections at once."""
    return cast("type[asyncio.Protocol]", partial(_Bounded, most, count()))


class _Bounded(H11Protocol):
    """Adds two clocks to uvicorn's protocol: one for requests sent, one for answers read."""

    def __init__(self, most: int, turns: Iterator[int], *given: Any, **named: Any):
        super().__init__(*given, **named)
        self._most, self._turns = most, turns
        self._turn = next(turns)  # when it became idle, among all
        self._owed = ""
        self._came = 0  # bytes since the clock began
        self._clock: asyncio.TimerHandle | None = None
        self._reading: asyncio.TimerHandle | None = None
        self._reads = 0  # times that the client has read something
        self._seen = (0, 0)  # reads and unread bytes at the last look

    @property
    def is_idle(self) -> bool:
        return self.cycle is None or self.cycle.response_complete  # pyright: ignore[reportUnnecessaryComparison]

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        super().connection_made(transport)
        self._watch()
        if len(self.connections) > self._most:
            others = [c for c in self.connections if isinstance(c, _Bounded) and c is not self]
            idle = [c for c in others if c.is_idle and not c.transport.is_closing()]
            # first a connection that has never sent a request
            victim = min(idle, key=lambda c: (c.cycle is not None, c._turn), default=self)  # pyright: ignore[reportUnnecessaryComparison]
            if victim.cycle is None:  # pyright: ignore[reportUnnecessaryComparison]
                victim.refuse(b"503 Service Unavailable")
            else:  # it had its answers, and would take a refusal for the next one
                victim.close()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch()
        self._came += len(data)  # after a clock that this begins

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._turn = next(self._turns)
        self._reads += 1
        self._watch()
        self._watch_reader()  # also where the connection is closing

    def connection_lost(self, exc: Exception | None) -> None:
        for clock in (self._clock, self._reading):
            if clock is not None:
                clock.cancel()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._watch_reader()

    def resume_writing(self) -> None:
        super().resume_writing()
        self._reads += 1

    def refuse(self, status: bytes) -> None:
        """Close an idle connection, with a reason for a client that waits for an answer."""
        self.transport.write(_REFUSAL % status)
        self.close()

    def close(self) -> None:
        """Close the connection once the client has read its answers, or has stopped reading."""
        self.transport.close()
        self._watch_reader()

    def _watch_reader(self) -> None:
        """Check every `_STALLED_S` that the client reads, while it has something to read."""
        unread = self.transport.get_write_buffer_size()
        if self._reading is None and (unread or self.transport.is_closing()):
            self._seen = (self._reads, unread)
            self._reading = self.loop.call_later(_STALLED_S, self._look_at_reader)

    def _look_at_reader(self) -> None:
        self._reading, (reads, before) = None, self._seen
        unread = self.transport.get_write_buffer_size()
        if unread and unread >= before and self._reads == reads:
            self.transport.abort()
        else:
            self._watch_reader()

    def _watch(self) -> None:
        """Start a clock for the headers or the body that the client has not sent yet."""
        if self.conn.their_state is h11.SEND_BODY:  # perhaps answered already
            owed = "body"
        elif not self.is_idle:
            owed = ""
        else:  # between requests, uvicorn's own clock runs until the first byte
            owed = "head" if self.cycle is None or self.conn.trailing_data[0] else ""  # pyright: ignore[reportUnnecessaryComparison]
        if owed == self._owed:
            return
        self._owed = owed
        if self._clock is not None:
            self._clock.cancel()
        self._start_clock()

    def _start_clock(self) -> None:
        owed, self._came = self._owed, 0
        self._clock = self.loop.call_later(_SECONDS[owed], self._late) if owed else None

    def _late(self) -> None:
        if self._owed == "head":
            self.refuse(b"408 Request Timeout")
        elif self.cycle.response_started:  # so that nobody waits for the rest of the body
            self.transport.abort()
        elif self._came >= _ENOUGH_BYTES:
            self._start_clock()
        else:
            self._refuse_body()

    def _refuse_body(self) -> None:
        """Answer 408 with the reason in the place of the application, and close the connection."""
        detail = (
            f"the body came too slowly: it has {_SECONDS['body']:.0f} s, and as long again if "
            f"{_ENOUGH_BYTES / 1e6:.0f} MB came in that time"
        )
        answer = problem(408, "request_timeout", detail)
        protect(answer.headers)
        headers = [*answer.raw_headers, (b"connection", b"close")]
        start = h11.Response(status_code=408, headers=headers, reason=b"Request Timeout")
        for event in (start, h11.Data(data=bytes(answer.body)), h11.EndOfMessage()):
            self.transport.write(self.conn.send(event) or b"")
        self.cycle.disconnected = True  # so that the application stops, and answers nothing more
        self.cycle.message_event.set()
        self.close()

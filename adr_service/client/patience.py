"""Requests that are sent again while a service is busy or away."""

import time
from collections.abc import Callable
from typing import TypeVar

from adr_service.client.http import Refused, Unreachable

T = TypeVar("T")
_BUSY = 503  # also during a commit


def patiently(
    ask: Callable[[], T],
    patience_s: float,
    poll_s: float,
    begins: Callable[[Refused | Unreachable], bool] = lambda error: True,
) -> T:
    """The answer to a request, asked for until the service takes it or refuses it for good.

    It gives up `patience_s` after the first failure, which may itself have come late. `poll_s` is
    the pause where the service does not say when to come back, and `begins` whether the request is
    sent again at all, after the first failure.
    """
    last: float | None = None
    while True:
        try:
            return ask()
        except (Refused, Unreachable) as error:
            if last is None:
                if not begins(error):
                    raise
                last = time.monotonic() + patience_s
            wait = error.retry_after_s if isinstance(error, Refused) else poll_s
            if wait is None or time.monotonic() + wait > last:
                raise
            time.sleep(wait)


def may_be_done(error: Refused | Unreachable) -> bool:
    """True if the service may have carried out a request all the same."""
    return error.status == _BUSY if isinstance(error, Refused) else error.may_be_done

"""Signs of life of running stages, and how long a stage may be silent.

A board, an actor of its own, takes the signs, so that the dispatcher waits for no stage:

    heartbeats = Heartbeats()                # starts the board
    signs, checkpoints = heartbeats.news(unwanted)   # since the last call; never waits
    heartbeats.silence(since)                # seconds, by the board's last answer

The board's process imports this module: it imports little, to be there soon.
"""

import logging
import time
from collections.abc import Set
from dataclasses import dataclass, replace
from typing import Any, cast

import ray
from ray.exceptions import RayError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from adr_service.progress import Checkpoint

log = logging.getLogger(__name__)
SILENT_S = 60.0  # without a sign of life, which comes every second, a process hangs
FIRST_SIGN_S = 180.0  # before the first one, while it starts and imports its libraries
UNWANTED_SILENT_S = 10.0  # if no run wants the result any more
UNWANTED_S = 30.0  # for which a stage may go on after its last run is cancelled; then it is killed
_READ_EVERY_S = 0.5


@dataclass(frozen=True)
class SignOfLife:
    """The latest report from inside a running stage."""

    digest: str
    attempt: int
    fraction: float  # of the stage that is done
    facts: dict[str, Any]  # for people
    actor_id: str
    pid: int
    checkpoint: Checkpoint | None = None  # only if it is new since the last sign


News = tuple[list[SignOfLife], dict[str, Checkpoint]]  # latest signs; checkpoints by digest


class Board:
    """Takes reports of running stages, and answers whether to stop. Needs no CPU of its own."""

    def __init__(self) -> None:
        self._latest: dict[tuple[str, int], SignOfLife] = {}  # by digest and attempt
        self._checkpoint: dict[str, Checkpoint] = {}  # new since the last call of `news`
        self._unwanted: Set[str] = frozenset()

    def report(self, sign: SignOfLife) -> bool:
        """Note a sign of life; True if no run wants the stage any more."""
        self._latest[sign.digest, sign.attempt] = replace(sign, checkpoint=None)
        if sign.checkpoint is not None:
            self._checkpoint[sign.digest] = sign.checkpoint
        return sign.digest in self._unwanted

    def news(self, unwanted: Set[str]) -> News:
        """The latest signs and checkpoints since the last call.

        `unwanted` has the stages that no run wants any more; all others may go on.
        """
        self._unwanted = unwanted
        news = list(self._latest.values()), self._checkpoint
        self._latest, self._checkpoint = {}, {}
        return news


class Heartbeats:
    """The dispatcher's side of the board. On the dispatcher's thread."""

    def __init__(self) -> None:
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)
        board = ray.remote(Board).options(num_cpus=0, max_restarts=-1, scheduling_strategy=here)
        self.board: Any = board.remote()
        self._reply: Any = None  # to a call of `news` that goes on
        self._asked_at = self._answered_at = time.monotonic()
        self._is_started = False  # its process answers

    def news(self, unwanted: Set[str]) -> News:
        """The board's news; empty until it has answered. Replaces a board that hangs.

        The board learns all `unwanted` stages each time, because a new one knows none.
        """
        since = time.monotonic() - self._asked_at
        if self._reply is None:
            if since > _READ_EVERY_S:
                self._asked_at = time.monotonic()
                self._reply = self.board.news.remote(unwanted)
            return [], {}
        done, _ = ray.wait([self._reply], timeout=0)
        if done:
            return self._read()
        # one that has answered is replaced before the stages that report there seem silent, and one
        # that starts gets as long as a stage does
        if since > (UNWANTED_SILENT_S if self._is_started else FIRST_SIGN_S):
            log.warning("the board: no answer for %.0f s", since)
            self._reply, self._is_started = None, False
            ray.kill(self.board, no_restart=False)
        return [], {}

    def silence(self, since: float) -> float:
        """Seconds of silence up to the board's last answer, after a sign at `since` (monotonic).

        This thread may have waited for the database after that answer.
        """
        return self._answered_at - since

    def _read(self) -> News:
        reply, self._reply = self._reply, None
        try:
            news = cast(News, ray.get(reply))
        except RayError as error:  # its process was lost; Ray starts another
            log.warning("the board was lost: %s", error)
            self._is_started = False
            return [], {}
        self._answered_at, self._is_started = self._asked_at, True
        return news


def patience_s(sign: SignOfLife | None, waiters: int) -> float:
    """Seconds after which a silent stage is ended, by its last sign and its number of waiters."""
    if not waiters:
        return UNWANTED_SILENT_S
    return FIRST_SIGN_S if sign is None else SILENT_S

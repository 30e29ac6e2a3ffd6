"""Where running stages report, in a process of its own; it imports little, to be there soon."""

from dataclasses import dataclass, replace
from typing import Any

from adr_service.progress import SoFar


@dataclass(frozen=True)
class SignOfLife:
    """The latest word from inside a running stage."""

    digest: str
    fraction: float
    facts: dict[str, Any]
    actor_id: str
    pid: int
    so_far: SoFar | None = None  # where there is a new one since the last sign


class Board:
    """Where running stages report, and read whether to stop. Needs no CPU of its own."""

    def __init__(self) -> None:
        self._latest: dict[str, SignOfLife] = {}
        self._so_far: dict[str, SoFar] = {}  # of stages that reported one since the last call
        self._unwanted: set[str] = set()

    def report(self, sign: SignOfLife) -> bool:
        """Note a sign of life; True tells the stage to stop."""
        self._latest[sign.digest] = replace(sign, so_far=None)
        if sign.so_far is not None:
            self._so_far[sign.digest] = sign.so_far
        return sign.digest in self._unwanted

    def news(self) -> tuple[list[SignOfLife], dict[str, SoFar]]:
        """The latest signs since the last call, and by digest what was found so far."""
        news = list(self._latest.values()), self._so_far
        self._latest, self._so_far = {}, {}
        return news

    def set_unwanted(self, digest: str, unwanted: bool) -> None:
        (self._unwanted.add if unwanted else self._unwanted.discard)(digest)

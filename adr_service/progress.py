"""Progress of a computation: its reports, and the request to stop."""

from dataclasses import dataclass
from typing import Any, Protocol


@dataclass(frozen=True)
class SoFar:
    """The best result of a computation that goes on, in the form of its final one."""

    values: dict[str, Any]
    blobs: dict[str, bytes]


class StageCancelled(Exception):
    """Raised inside a stage by its `Progress` when no run wants the result."""


class Progress(Protocol):
    """Called often from inside a stage; must be cheap. May raise `StageCancelled`."""

    def __call__(self, fraction: float, so_far: SoFar | None = None, **facts: Any) -> None: ...


def part_of(progress: Progress, done: int, parts: int) -> Progress:
    """Progress of the next of `parts` equal parts, after `done` of them."""

    def report(fraction: float, so_far: SoFar | None = None, **facts: Any) -> None:
        progress((done + fraction) / parts, so_far=so_far, **facts)

    return report


def silent(fraction: float, so_far: SoFar | None = None, **facts: Any) -> None:
    """Report progress to nobody."""

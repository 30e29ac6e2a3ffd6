"""Progress of computations, and the cancelling of those that no run waits for any more."""

from dataclasses import dataclass
from typing import Any, Protocol

from adr_service.events import RunEvent


@dataclass(frozen=True)
class Checkpoint:
    """The best that a computation has so far, kept in case its process is lost."""

    steps: int  # of the computation; of two checkpoints the one with more steps is kept
    content: bytes
    events: tuple[RunEvent, ...]  # for the record of the runs that wait


class StageCancelled(Exception):
    """Raised inside a stage by its `Progress` when no run wants the result."""


class Progress(Protocol):
    """Called often from inside a stage; must be cheap. May raise `StageCancelled`."""

    def __call__(
        self, fraction: float, checkpoint: Checkpoint | None = None, **facts: Any
    ) -> None: ...


def part_of(progress: Progress, done: int, parts: int) -> Progress:
    """Progress of one of `parts` equal parts, after `done` finished ones."""

    def report(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
        progress((done + fraction) / parts, checkpoint=checkpoint, **facts)

    return report


def silent(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
    """A progress callback that does nothing."""

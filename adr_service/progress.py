"""How long computations say that they live, and learn that nobody wants them any more."""

from typing import Any, Protocol


class StageCancelled(Exception):
    """Raised inside a stage by its `Progress` when no run wants the result."""


class Progress(Protocol):
    """Called often from inside a stage; must be cheap. May raise `StageCancelled`."""

    def __call__(self, fraction: float, **facts: Any) -> None: ...


def part_of(progress: Progress, done: int, parts: int) -> Progress:
    """Progress of the next of `parts` equal parts, of which `done` are behind."""

    def report(fraction: float, **facts: Any) -> None:
        progress((done + fraction) / parts, **facts)

    return report


def silent(fraction: float, **facts: Any) -> None:
    """The progress nobody looks at."""

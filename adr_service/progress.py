"""Progress of computations, and the cancelling of those that no run waits for any more."""

import math
from dataclasses import dataclass
from typing import Any, Protocol

from adr_service.errors import InvalidInput
from adr_service.events import RunEvent
from adr_service.json_values import encodable

_LONGEST = 200  # characters of a fact


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


def checked(progress: Progress) -> Progress:
    """Progress whose facts are JSON, for people: arrays and NaN become text, and long text is cut.

    It raises InvalidInput for a fraction that is not finite.
    """

    def report(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
        if not math.isfinite(fraction):
            raise InvalidInput(f"progress takes the fraction that is done; given {fraction}")
        shown = {name: _shown(value) for name, value in facts.items()}
        progress(float(fraction), checkpoint=checkpoint, **shown)

    return report


def _shown(value: Any) -> Any:
    if getattr(value, "ndim", None) == 0:  # NumPy's and JAX's numbers
        value = value.item()
    if value is None or isinstance(value, int):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    text = encodable(str(value))
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def silent(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
    """A progress callback that does nothing."""

"""Progress of computations, and the cancelling of those that no run waits for any more."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from adr_service.errors import InvalidInput
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
    """Called often from inside a stage; must be cheap. May raise `StageCancelled`.

    Raises InvalidInput for a fraction that is not finite.
    """

    def __call__(
        self, fraction: float, checkpoint: Checkpoint | None = None, **facts: Any
    ) -> None: ...


def part_of(progress: Progress, done: int, parts: int) -> Progress:
    """Progress of one of `parts` equal parts, after `done` finished ones."""

    def report(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
        progress((done + fraction) / parts, checkpoint=checkpoint, **facts)

    return report


def finite(fraction: float) -> float:
    """The fraction, for which NaN and infinity are refused."""
    if not math.isfinite(fraction):
        raise InvalidInput(f"progress takes the fraction that is done; given {fraction}")
    return float(fraction)


def readable(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Facts for people as JSON has them: arrays and what is not finite become text."""
    return {name: _readable(value) for name, value in facts.items()}


def _readable(value: Any) -> Any:
    if getattr(value, "ndim", None) == 0:  # NumPy's and JAX's numbers
        value = value.item()
    is_json = value is None or isinstance(value, str | int)
    return value if is_json or (isinstance(value, float) and math.isfinite(value)) else str(value)


def silent(fraction: float, checkpoint: Checkpoint | None = None, **facts: Any) -> None:
    """A progress callback that does nothing."""

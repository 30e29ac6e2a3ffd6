"""Limits that the owner of a robot sets, whatever a task asks for."""

from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput

_STEP_S = 60.0  # after which a step, of milliseconds usually, means that the environment hangs
_SLACK_S = 1.0  # beyond the owner's limit and one control step: the last one began within it


@dataclass(frozen=True)
class Limits:
    """Limits on the time of episodes and resets, and on actions."""

    seconds: float | None = None  # of an episode, by the clock and by its steps
    reset_seconds: float = 120.0
    actions: tuple[float, ...] = ()  # largest magnitudes: one for all, or one for each; (): none

    def __post_init__(self) -> None:
        """Raises InvalidInput for a time that is not positive and finite."""
        for name, given in (("an episode", self.seconds), ("a reset", self.reset_seconds)):
            if given is not None and not 0 < given < np.inf:
                raise InvalidInput(f"{name} takes a positive and finite time; given {given} s")

    def allows(self, seconds: float) -> bool:
        """True if an episode may take so long."""
        return self.seconds is None or seconds <= self.seconds

    def left(self, seconds: float, period_s: float) -> float:
        """Longest time of a step of `period_s` that begins `seconds` after the episode."""
        whole = _STEP_S if self.seconds is None else self.seconds - seconds + period_s + _SLACK_S
        return min(_STEP_S, whole)

    def apply(self, action: Vector) -> Vector:
        """Return the nearest action within the limits."""
        if not self.actions:
            return action
        most = np.broadcast_to(np.array(self.actions), action.shape)
        return np.clip(action, -most, most)

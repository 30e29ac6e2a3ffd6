"""A run's program over its stored results: what its events must be, and with which stages.

replay = replay_run(run_id, spec, find)
replay.disagreements(stored)        # [] where the stored events follow from the results
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from adr_service.errors import InvalidInput
from adr_service.events import IterationFinished, RunEvent, TrainingEvaluated
from adr_service.programs import run
from adr_service.specs import RunSpec
from adr_service.stages.base import AnyStage, StageResult
from adr_service.stages.stored import ResultBroken, ResultMissing, StoredStages

# numbers that a program computes from results: sums differ so much between types of CPU
_RELATIVE, _ABSOLUTE = 1e-9, 1e-12


@dataclass(frozen=True)
class Replay:
    """The events and stages of a run, as far as its results go."""

    events: dict[str, RunEvent]  # by key; those of the program alone
    stages: list[AnyStage]  # those that have a result
    is_complete: bool  # the program came to its end
    broken: str = ""  # the error that ended it, as that of a method of one's own may

    def disagreements(self, stored: Mapping[str, RunEvent]) -> list[str]:
        """Keys of the stored events that differ from those which the results lead to."""
        differ = [
            key
            for key, event in _fixed(stored).items()
            if key in self.events and not repeats(self.events[key], event)
        ]
        return differ + (self._beyond(stored) if self.is_complete else [])

    def lacking(self, stored: Mapping[str, RunEvent], has_succeeded: bool) -> list[str]:
        """Keys of iterations that the results lead to, but that are not stored.

        A run that was stopped may lack its last ones. No service leaves a gap, or ends a run well
        without all of them.
        """
        mine = [key for key, e in self.events.items() if isinstance(e, IterationFinished)]
        written = [number for number, key in enumerate(mine, 1) if key in stored]
        last = len(mine) if has_succeeded else max(written, default=0)
        return [key for key in mine[:last] if key not in stored]

    def is_behind(self, stored: Mapping[str, RunEvent]) -> bool:
        """True if the results end before the stored events do, so that some cannot be checked.

        An earlier version's results have other digests, which this one does not ask for.
        """
        return not self.is_complete and bool(self._beyond(stored))

    def _beyond(self, stored: Mapping[str, RunEvent]) -> list[str]:
        return [key for key in _fixed(stored) if key not in self.events]


def _fixed(stored: Mapping[str, RunEvent]) -> dict[str, RunEvent]:
    """The events that results determine.

    Points of a learning curve are written while a training goes on. If it is interrupted and
    repeated on another type of CPU, points of both stay, and the result has its own curve.
    """
    return {k: event for k, event in stored.items() if not isinstance(event, TrainingEvaluated)}


def replay_run(run_id: str, spec: RunSpec, find: Callable[[str], StageResult | None]) -> Replay:
    """Run a program over results that `find` looks up by digest, to its end or theirs.

    Raises InvalidInput where a result cannot be the one of its stage.
    """
    stages, events, broken = StoredStages(run_id, find), dict[str, RunEvent](), ""
    is_complete = False
    try:
        for event in run(spec, stages):
            events[event.key] = event
        is_complete = True
    except ResultMissing:
        pass
    except ResultBroken as error:
        raise InvalidInput(f"{run_id} cannot use a stored result: {error}") from error
    except Exception as error:  # noqa: BLE001 - methods, and results of strangers, break in any way
        where = f"after {stages.asked[-1].kind}" if stages.asked else "before its first stage"
        broken = f"the program of {run_id} cannot use its stored results, {where}: {error}"
    return Replay(events, stages.asked, is_complete, broken)


def repeats(event: RunEvent, stored: RunEvent) -> bool:
    """True if an event says what a stored one said, which an earlier version wrote with fewer
    fields, perhaps."""
    fields = stored.model_fields_set
    return agree(event.model_dump(include=fields), stored.model_dump(include=fields))


def agree(one: Any, other: Any, relative: float = _RELATIVE, absolute: float = _ABSOLUTE) -> bool:
    """True if two JSON values are equal up to rounding of their numbers."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        left, right = cast(Mapping[str, Any], one), cast(Mapping[str, Any], other)
        return left.keys() == right.keys() and all(
            agree(left[name], right[name], relative, absolute) for name in left
        )
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        some, others = cast(Sequence[Any], one), cast(Sequence[Any], other)
        return len(some) == len(others) and all(
            agree(a, b, relative, absolute) for a, b in zip(some, others, strict=True)
        )
    if isinstance(one, float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=relative, abs_tol=absolute)
    return one == other

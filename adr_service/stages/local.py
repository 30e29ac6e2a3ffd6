"""Stages that run in this process, one after the other.

for event in run(spec, LocalStages()):
    print(event.key)
"""

from collections.abc import Generator, Sequence
from typing import Any, TypeVar

from adr_service.events import RunEvent
from adr_service.stages.base import R, Stage, StageResult, compute, events_of

T = TypeVar("T")


def drained(program: Generator[RunEvent, None, T]) -> T:
    """Run a program to its end, and return its result."""
    while True:
        try:
            next(program)
        except StopIteration as end:
            return end.value


class LocalStages:
    """Computes each stage once, and remembers its result by digest."""

    run_id = "local"

    def __init__(self) -> None:
        self.results: dict[str, StageResult] = {}
        self.executed: list[Stage[Any]] = []

    def all(self, stages: Sequence[Stage[R]]) -> Generator[RunEvent, None, list[R]]:
        results: list[R] = []
        for stage in stages:
            if stage.digest not in self.results:
                self.results[stage.digest] = compute(stage)
                self.executed.append(stage)
            results.append(stage.read(self.results[stage.digest]))
            yield from events_of(stage, results[-1])
        return results

    def run(self, stage: Stage[R]) -> Generator[RunEvent, None, R]:
        return (yield from self.all([stage]))[0]

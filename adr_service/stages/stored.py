"""Stages that answer with stored results and compute nothing.

stages = StoredStages(run_id, find)
for event in run(spec, stages, recording):       # ResultMissing where the results end
    print(event.key)
stages.asked                                     # the stages, with all their inputs
"""

from collections.abc import Callable, Generator, Sequence
from typing import Any

from adr_service.errors import AdrError
from adr_service.events import RunEvent
from adr_service.stages.base import R, Stage, StageResult, events_of


class ResultMissing(AdrError):
    """A program asks for a stage that has no stored result."""

    code = "result_missing"


class ResultBroken(AdrError):
    """A stored result cannot be the one of its stage."""

    code = "result_broken"


class StoredStages:
    """The stages of one run, from a store that `find` looks up by digest."""

    def __init__(self, run_id: str, find: Callable[[str], StageResult | None]):
        self.run_id, self._find = run_id, find
        self.asked: list[Stage[Any]] = []  # those that have a result

    def all(self, stages: Sequence[Stage[R]]) -> Generator[RunEvent, None, list[R]]:
        results: list[R] = []
        for stage in stages:
            stored = self._find(stage.digest)
            if stored is not None:
                try:
                    results.append(stage.read(stored))
                except Exception as error:  # a stranger's result may have any form
                    raise ResultBroken(f"that of {stage.kind}: {error}") from error
                self.asked.append(stage)
                yield from events_of(stage, results[-1])
        if len(results) < len(stages):
            raise ResultMissing(f"{len(stages) - len(results)} results are missing")
        return results

    def run(self, stage: Stage[R]) -> Generator[RunEvent, None, R]:
        return (yield from self.all([stage]))[0]

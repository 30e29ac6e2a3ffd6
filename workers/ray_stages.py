"""Stages that run on Ray, with their results in the database."""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait

from adr_service.errors import RunCancelled
from adr_service.events import RunEvent
from adr_service.stages.base import R, Stage, StageResult, events_of
from workers.cluster import ClusterUnavailable
from workers.dispatcher import Dispatcher

_POLL_S = 1.0  # between two looks whether the run is to stop


class RayStages:
    """The `Stages` of one run in the service."""

    def __init__(self, run_id: str, dispatcher: Dispatcher, is_cancelled: Callable[[], bool]):
        self.run_id, self._dispatcher = run_id, dispatcher
        self.is_cancelled = is_cancelled

    def all(self, stages: Sequence[Stage[R]]) -> Generator[RunEvent, None, list[R]]:
        futures = [self._dispatcher.submit(stage, self.run_id) for stage in stages]
        waiting: dict[Future[StageResult], Stage[R]] = dict(zip(futures, stages, strict=True))
        results: dict[Future[StageResult], R] = {}
        while waiting:
            if self.is_cancelled():
                raise RunCancelled("the run was asked to stop")
            if not self._dispatcher.is_alive:
                raise ClusterUnavailable("the cluster has stopped; restart the service")
            done, _ = wait(waiting, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for future in [f for f in futures if f in done]:
                stage = waiting.pop(future)
                results[future] = stage.read(future.result())  # or raises the stage's failure
                yield from events_of(stage, results[future])
        return [results[future] for future in futures]

    def run(self, stage: Stage[R]) -> Generator[RunEvent, None, R]:
        return (yield from self.all([stage]))[0]

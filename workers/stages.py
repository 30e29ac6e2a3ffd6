"""Stages that run on Ray and are remembered in the database."""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait

from adr_service.errors import RunCancelled
from adr_service.events import RunEvent
from adr_service.stages import Stage, StageResult, events_of
from workers.cluster import ClusterUnavailable
from workers.dispatcher import Dispatcher

_POLL_S = 1.0  # to look whether the run is to stop


class RayStages:
    """The `Stages` of one run in the service."""

    def __init__(self, run_id: str, dispatcher: Dispatcher, is_cancelled: Callable[[], bool]):
        self.run_id, self._dispatcher = run_id, dispatcher
        self._is_cancelled = is_cancelled

    def all(self, stages: Sequence[Stage]) -> Generator[RunEvent, None, list[StageResult]]:
        asked: dict[Future[StageResult], Stage] = {}
        futures = [self._dispatcher.submit(stage, self.run_id) for stage in stages]
        asked.update(zip(futures, stages, strict=True))
        while asked:
            if self._is_cancelled():
                raise RunCancelled("the run was asked to stop")
            if not self._dispatcher.is_alive:
                raise ClusterUnavailable("the cluster has stopped; restart the service")
            done, _ = wait(asked, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for future in [f for f in futures if f in done]:
                stage = asked.pop(future)
                yield from events_of(stage, future.result())  # or raises what went wrong
        return [future.result() for future in futures]

    def run(self, stage: Stage) -> Generator[RunEvent, None, StageResult]:
        return (yield from self.all([stage]))[0]

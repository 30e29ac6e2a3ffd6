"""Keeps every unfinished run going: one thread per run, iterating its program.

Resuming is running the program again; finished stages answer at once from the database. So a
service that starts simply runs whatever is unfinished, whether it was stopped or killed.
"""

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from typing import TypeVar

from sqlalchemy.orm import Session

from adr_service.benchmark.utilisation import Timing
from adr_service.errors import AdrError, RunCancelled, StageFailed
from adr_service.events import (
    RunEvent,
    RunFailed,
    RunStarted,
    RunStopped,
    RunSucceeded,
)
from adr_service.progress import SoFar
from adr_service.runs import run
from adr_service.stages import Stage, StageResult, events_of, learning_curve
from db import datasets as dataset_store
from db import runs as run_store
from db import stages as stage_store
from db.runs import RunRecord
from db.session import RETRY_S, Database, DatabaseUnavailable
from workers.actors import Finished
from workers.cluster import ClusterUnavailable, RayOptions
from workers.dispatcher import Activity, Attempt, Dispatcher
from workers.stages import RayStages

log = logging.getLogger(__name__)
T = TypeVar("T")
_RUNS_AT_ONCE = 64  # threads that mostly wait; the cores are shared out by the dispatcher


class Orchestrator:
    """Runs the runs of one database on one cluster."""

    def __init__(self, database: Database, options: RayOptions):
        self._database = database
        self._dispatcher = Dispatcher(options, self._find, self._commit, self._note)
        self._pool = ThreadPoolExecutor(_RUNS_AT_ONCE, thread_name_prefix="run")
        self._cancelled: dict[str, threading.Event] = {}
        self._waiting: dict[str, Future[None]] = {}
        self._closing = threading.Event()

    def start(self) -> None:
        """Start Ray, and go on with every unfinished run."""
        self._dispatcher.start()
        for record in run_store.unfinished_runs(self._database):
            self.submit(record)

    def close(self) -> None:
        """Stop without a trace in the runs: they go on when the service starts again."""
        self._closing.set()
        self._dispatcher.close()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def submit(self, record: RunRecord) -> None:
        """Run a stored run; it may have begun before."""
        flag = self._cancelled[record.id] = threading.Event()
        self._waiting[record.id] = self._pool.submit(self._guard, record, flag)

    def cancel(self, record: RunRecord) -> None:
        """Stop a run at its next stage, or at once where it has no thread yet."""
        if flag := self._cancelled.get(record.id):
            flag.set()
        waiting = self._waiting.get(record.id)
        if waiting is not None and waiting.cancel():
            del self._cancelled[record.id], self._waiting[record.id]
            stopped = RunStopped(submission=record.submission)
            try:
                run_store.append_event(self._database, record.id, stopped)
            except DatabaseUnavailable:  # nobody who asks should have to wait for it
                threading.Thread(target=self._record, args=(record, stopped), daemon=True).start()

    @property
    def is_alive(self) -> bool:
        return self._dispatcher.is_alive

    @property
    def cores(self) -> int:
        return self._dispatcher.cores

    @property
    def dashboard_url(self) -> str | None:
        return self._dispatcher.dashboard_url

    def activities(self, run_id: str) -> list[Activity]:
        return self._dispatcher.activities(run_id)

    def _guard(self, record: RunRecord, flag: threading.Event) -> None:
        """Iterate a run's program to an end that is on record, whatever happens."""
        try:
            self._record(record, RunStarted(submission=record.submission))
            now = self._when_possible(lambda: run_store.get_run(self._database, record.id))
            if now.cancel_requested:  # perhaps before there was a flag
                flag.set()
            stages = RayStages(
                record.id, self._dispatcher, lambda: flag.is_set() or self._closing.is_set()
            )
            for event in run(record.spec, stages, self._recording(record)):
                self._record(record, event)
            ending: RunEvent = RunSucceeded()
        except RunCancelled:
            ending = RunStopped(submission=record.submission)
        except StageFailed as error:
            ending = _failure(record, error.cause, str(error))
        except ClusterUnavailable:
            log.exception("run %s waits for the service to be restarted", record.id)
            return
        except AdrError as error:
            ending = _failure(record, error.code, str(error))
        except Exception as error:  # the last place that can put a defect on the run's record
            log.exception("run %s failed", record.id)
            ending = _failure(record, "internal", f"{type(error).__name__}: {error}")
        if self._closing.is_set() and not isinstance(ending, RunSucceeded):
            return  # the service stops, not the run: it goes on when the service starts again
        self._dispatcher.withdraw(record.id)
        self._cancelled.pop(record.id, None)
        self._waiting.pop(record.id, None)
        self._record(record, ending)

    def _record(self, record: RunRecord, event: RunEvent) -> None:
        self._when_possible(lambda: run_store.append_event(self._database, record.id, event))

    def _when_possible(self, action: Callable[[], T]) -> T:
        """What needs the database, once that can be used; RunCancelled where the service stops."""
        while True:
            try:
                return action()
            except DatabaseUnavailable as error:
                log.warning("%s; trying again in %g s", error, RETRY_S)
                if self._closing.wait(RETRY_S):
                    raise RunCancelled("the service is stopping") from error

    def _recording(self, record: RunRecord) -> bytes | None:
        id = record.spec.dataset
        if id is None:
            return None
        return self._when_possible(lambda: dataset_store.load_dataset(self._database, id)[1])

    def _find(self, stage: Stage, run_id: str) -> StageResult | None:
        """A stored result, which from now on this run refers to as well."""
        with self._database.write("find_result") as session:
            result = stage_store.find_result(session, stage.digest)
            if result is not None:
                _append_to_all(session, [run_id], events_of(stage, result))
            return result

    def _note(self, stage: Stage, so_far: SoFar, run_ids: list[str]) -> None:
        """Store the learning curve and the best policy of a training that goes on."""
        with self._database.write("note_checkpoint") as session:
            steps = so_far.values["curve"][-1]["steps"]
            stage_store.note_checkpoint(session, stage.digest, steps, so_far.blobs["policy"])
            _append_to_all(session, run_ids, learning_curve(stage.digest, so_far.values))

    def _commit(
        self, stage: Stage, finished: Finished, attempt: Attempt, run_ids: list[str]
    ) -> None:
        events = events_of(stage, finished.result)
        timing = Timing(
            asked=attempt.asked,
            placed=attempt.placed,
            cores=attempt.cores,
            **asdict(finished.work),
        )
        stage_store.commit_result(
            self._database,
            stage,
            finished.result,
            stage_store.Execution(attempt.number, attempt.started_by, timing, finished.provenance),
            lambda session: _append_to_all(session, run_ids, events),
        )


def _append_to_all(session: Session, run_ids: list[str], events: list[RunEvent]) -> None:
    for run_id in run_ids:
        if run_store.exists(session, run_id):  # it may have been deleted meanwhile
            run_store.append_all(session, run_id, events)


def _failure(record: RunRecord, code: str, message: str) -> RunFailed:
    return RunFailed(submission=record.submission, code=code, message=message)

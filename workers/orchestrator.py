"""Keeps every unfinished run going: one thread per run, iterating its program.

    orchestrator = Orchestrator(database, RayOptions(cpus=2))
    orchestrator.start()                 # and go on with every unfinished run
    orchestrator.submit(record)
    orchestrator.close()                 # the runs go on when a service starts again

Resuming is running the program again; finished stages answer at once from the database. So a
service that starts simply runs whatever is unfinished, whether it was stopped or killed.
"""

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple, Protocol, TypeVar

from structlog.contextvars import bound_contextvars

from adr_service.errors import AdrError, FailureCode, InvalidInput, RunCancelled, StageFailed
from adr_service.events import (
    RunEvent,
    RunFailed,
    RunStopped,
    RunSucceeded,
    StageFinished,
)
from adr_service.json_values import encodable
from adr_service.programs import run
from adr_service.specs import AnyRun, LostRun, RunSpec
from adr_service.stages.base import Stages
from adr_service.stages.target_episode import RobotEpisode, read_episode
from adr_service.transitions import TransitionDataset
from db import datasets as dataset_store
from db import events as event_store
from db import runs as run_store
from db import visits as visit_store
from db.clock import SteadyClock
from db.errors import DatabaseUnavailable
from db.models import LONGEST_CODE
from db.runs import RunRecord
from db.session import RETRY_S, Database
from db.visits import Visit
from workers.cluster import ClusterUnavailable, RayOptions
from workers.dispatcher import Dispatcher
from workers.jobs import Activity
from workers.ray_stages import RayStages
from workers.results import DatabaseResults, outages

log = logging.getLogger(__name__)
T = TypeVar("T")
RUNS_AT_ONCE = 64  # threads that mostly wait; the cores are shared out by the dispatcher
_EXTERNAL_AT_ONCE = 1000  # they wait for robots, for days if need be


class Program(Protocol):
    """The events of a run, computed by `stages`; `recording` is the `.npz` that it learns from."""

    def __call__(
        self, spec: AnyRun | LostRun, stages: Stages, recording: bytes | None, /
    ) -> Iterator[RunEvent]: ...


class _Live(NamedTuple):
    """A run that has its thread, or will have."""

    cancelled: threading.Event
    thread: Future[None]


class Orchestrator:
    """Runs the runs of one database on one cluster."""

    def __init__(
        self,
        database: Database,
        options: RayOptions,
        program: Program = run,
        runs_at_once: int = RUNS_AT_ONCE,
    ):
        self._database, self._program = database, program
        self._dispatcher = Dispatcher(options, DatabaseResults(database))
        self._ours = ThreadPoolExecutor(runs_at_once, thread_name_prefix="run")
        self._external = ThreadPoolExecutor(_EXTERNAL_AT_ONCE, thread_name_prefix="external")
        self._recorder = ThreadPoolExecutor(1, thread_name_prefix="record")
        self._live: dict[tuple[str, int], _Live] = {}  # by run and submission
        self._changing = threading.Lock()
        self.clock = SteadyClock()  # for leases
        self._closing = threading.Event()

    def start(self) -> None:
        """Start Ray, and go on with every unfinished run."""
        self._dispatcher.start()
        visit_store.forget_unclaimed(self._database)
        self.adopt()

    def close(self) -> None:
        """Stop without an event in the runs: they go on when the service starts again."""
        self._closing.set()
        pools = (self._ours, self._external, self._recorder)
        for pool in pools:  # nothing that waits for a thread begins any more
            pool.shutdown(wait=False, cancel_futures=True)
        self._dispatcher.close()
        for pool in pools:
            pool.shutdown()

    def adopt(self) -> None:
        """Submit stored runs without a thread: those of an earlier service, or of a lost answer."""
        with self._changing:
            live = set(self._live)
        for record in run_store.unfinished_runs(self._database, live):
            self.submit(record)

    def submit(self, record: RunRecord) -> None:
        """Give a stored run its thread, unless it has one; the run may have begun before."""
        spec = record.spec
        is_external = isinstance(spec, RunSpec) and spec.target.kind == "external"
        pool = self._external if is_external else self._ours
        with self._changing:
            if _key(record) not in self._live:
                flag = threading.Event()
                self._live[_key(record)] = _Live(flag, pool.submit(self._run, record, flag))

    def cancel(self, *records: RunRecord) -> None:
        """Stop runs at their next stage, or at once where they have no thread yet."""
        unstarted: list[tuple[str, RunEvent]] = []
        adopted: list[RunRecord] = []  # whose submission was stored without an answer
        with self._changing:
            for record in records:
                live = self._live.get(_key(record))
                if live is None:
                    if not record.is_finished:
                        adopted.append(record)
                    continue
                live.cancelled.set()
                if live.thread.cancel():
                    del self._live[_key(record)]
                    self._dispatcher.withdraw(record.id)  # of an earlier submission, if any
                    unstarted.append((record.id, RunStopped(submission=record.submission)))
        for record in adopted:
            self.submit(record)
        batches = run_store.batches(unstarted)
        try:
            event_store.append_events(self._database, next(batches, ()))
        except DatabaseUnavailable:
            batches = run_store.batches(unstarted)
        for batch in batches:  # the caller should not have to wait for them
            self._recorder.submit(self._record_all, batch)

    def complete_task(self, id: str, lease: str, content: bytes) -> Visit:
        """Accept a robot's episode, the `.npz` of `read_episode`, and let its run go on."""
        visit = visit_store.claimed_by(self._database, id, lease)  # before anything is unpacked
        episode = read_episode(visit.task, visit.inputs["transitions"], content)
        if visit.inputs["purpose"] == "rollout":
            self._check_useful(visit, episode)
        finished = StageFinished(kind=visit.kind, digest=visit.digest)
        try:
            return visit_store.complete(
                self._database,
                id,
                lease,
                episode.to_stored(),
                episode.transitions,
                self.clock.now(),
                lambda session: event_store.append_to_all(session, [visit.run_id], [finished]),
            )
        finally:  # a server that fails while it answers may have stored the episode
            self._dispatcher.arrived(visit.digest)

    def _check_useful(self, visit: Visit, episode: RobotEpisode) -> None:
        """Refuse a rollout that the run's method cannot learn from, before it is stored.

        One of several random episodes may be too short: the method learns from them together.
        """
        spec = run_store.get_run(self._database, visit.run_id).spec
        if not isinstance(spec, RunSpec):
            return
        if spec.method.replay_from == "smoothed":
            TransitionDataset.from_npz(episode.data).check_chained("smoothing")
        least = spec.method.least_transitions
        if episode.transitions < least and spec.collector != "random_matched":
            raise InvalidInput(
                f"the rollout has {episode.transitions} transitions; {spec.method.name} with "
                f"steps = {least} learns from no fewer in a row"
            )

    def fail_task(self, id: str, lease: str, message: str) -> Visit:
        """Fail a visit that no robot can do; its run fails with the message.

        The run's failure is stored together with the visit's: a service that ended in between would
        offer the visit again.
        """
        visit = visit_store.get_visit(self._database, id)
        try:
            failed = visit_store.fail(
                self._database,
                id,
                lease,
                message,
                lambda session, run_id, error: event_store.end(
                    session,
                    run_id,
                    lambda submission: _failure(submission, error.cause, str(error)),
                ),
            )
        except DatabaseUnavailable:  # it may have stored the failure
            self._dispatcher.arrived(visit.digest)
            raise
        self._dispatcher.refused(failed.digest, message)
        return failed

    @property
    def is_alive(self) -> bool:
        """True if runs can go on."""
        return self._dispatcher.is_alive

    @property
    def silent_s(self) -> float:
        """Seconds for which the dispatcher has waited for Ray, or for the database to write."""
        return self._dispatcher.silent_s

    @property
    def cores(self) -> int:
        """Cores of the whole cluster, as last seen."""
        return self._dispatcher.cores

    @property
    def dashboard_url(self) -> str | None:
        """Address of Ray's dashboard, once Ray has started."""
        return self._dispatcher.dashboard_url

    def activities(self, run_id: str | None = None) -> list[Activity]:
        """Stages that a run waits for, or all runs."""
        return self._dispatcher.activities(run_id)

    def _run(self, record: RunRecord, flag: threading.Event) -> None:
        with bound_contextvars(run=record.id):  # in all its log says
            try:
                self._guard(record, flag)
            except Exception:
                log.exception("the end of the run could not be recorded")
                raise
            finally:
                with self._changing:
                    del self._live[_key(record)]

    def _guard(self, record: RunRecord, flag: threading.Event) -> None:
        """Bring a run to an end that is on its record, whatever happens in between."""
        if self._closing.is_set():
            return  # it has not begun, and will when the service starts again
        ending = self._ending(record, flag)
        if ending is None or (self._closing.is_set() and not isinstance(ending, RunSucceeded)):
            return  # it goes on when the service starts again
        with self._changing:  # a later submission may wait for the same stages already
            if not any(id == record.id and n > record.submission for id, n in self._live):
                self._dispatcher.withdraw(record.id)
        self._record(record, ending)
        level = logging.WARNING if isinstance(ending, RunFailed) else logging.INFO
        log.log(level, "run ended: %s", getattr(ending, "message", ending.type))

    def _ending(self, record: RunRecord, flag: threading.Event) -> RunEvent | None:
        """Iterate a run's program; the event that ends the run, or None if it has no end yet."""
        try:
            return RunSucceeded() if self._iterate(record, flag) else None
        except RunCancelled:
            return RunStopped(submission=record.submission)
        except StageFailed as error:
            return _failure(record.submission, error.cause, str(error))
        except ClusterUnavailable:
            if not self._closing.is_set():
                log.exception("run %s waits for the service to be restarted", record.id)
            return None
        except AdrError as error:
            return _failure(record.submission, error.code, str(error))
        # the last place that can put a defect on the run's record; a method may even exit
        except (Exception, SystemExit) as error:
            log.exception("run %s failed", record.id)
            return _failure(
                record.submission, FailureCode.INTERNAL, f"{type(error).__name__}: {error}"
            )

    def _iterate(self, record: RunRecord, flag: threading.Event) -> bool:
        """Iterate a run's program to its end; False if the run has ended since it was read."""
        now = self._when_possible(lambda: run_store.begin(self._database, record))
        if now is None:
            return False
        if now.cancel_requested:  # perhaps before there was a flag
            flag.set()
        stages = RayStages(
            record.id, self._dispatcher, lambda: flag.is_set() or self._closing.is_set()
        )
        for event in self._program(record.spec, stages, self._recording(record)):
            self._record(record, event)
        return True

    def _record(self, record: RunRecord, event: RunEvent) -> None:
        self._when_possible(lambda: event_store.append_event(self._database, record.id, event))

    def _record_all(self, events: Sequence[tuple[str, RunEvent]]) -> None:
        try:
            self._when_possible(lambda: event_store.append_events(self._database, events))
        except RunCancelled:
            pass  # the service stops; when it starts again, these runs stop first
        except Exception:  # those of other batches are recorded all the same
            log.exception("the end of cancelled runs could not be recorded")

    def _when_possible(self, action: Callable[[], T]) -> T:
        """Call `action` until the database can be used; RunCancelled if the service stops."""
        while True:
            try:
                return action()
            except DatabaseUnavailable as error:
                outages.warning("%s; trying again in %g s", error, RETRY_S)
                if self._closing.wait(RETRY_S):
                    raise RunCancelled("the service is stopping") from error

    def _recording(self, record: RunRecord) -> bytes | None:
        id = record.spec.dataset
        if id is None:
            return None
        return self._when_possible(lambda: dataset_store.load_dataset(self._database, id)[1])


def _key(record: RunRecord) -> tuple[str, int]:
    return record.id, record.submission


def _failure(submission: int, code: str, message: str) -> RunFailed:
    code = str(code)  # a user's error class may have one of any type
    if len(code) > LONGEST_CODE:
        code, message = FailureCode.INTERNAL, f"{code}: {message}"
    text = message.replace("\0", "\\0")  # PostgreSQL cannot store a NUL, nor JSON half a letter
    return RunFailed(submission=submission, code=code, message=encodable(text))

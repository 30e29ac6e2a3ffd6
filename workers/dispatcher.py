"""Decides which stage runs where and when; the one thread that talks to Ray.

Each core computes one stage at a time (see `workers.slots`). Equal stages are computed once: who
asks later waits for the same result. A lost process means another attempt, three at most.

`ray.init` and everything after it happen on one thread that lives as long as the service: Ray's
processes die with the thread that started them, and on the main thread Ray would steal signals.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, cast

import ray
from ray.exceptions import RayError, RayTaskError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from adr_service.errors import AdrError, RunCancelled, StageFailed
from adr_service.progress import SoFar
from adr_service.stages import KINDS, Role, Stage, StageResult
from db.errors import DatabaseUnavailable
from db.session import RETRY_S
from workers.actors import Ending, Failed, Finished, Stopped
from workers.attempt import Attempt
from workers.board import Board, SignOfLife
from workers.cluster import Cluster, ClusterUnavailable, RayOptions
from workers.ledger import Ledger
from workers.slots import Actor, Slots

log = logging.getLogger(__name__)
MAX_ATTEMPTS = 3
_TICK_S = 0.05
_READ_BOARD_S = 0.5
_SILENT_S = 60.0  # without a sign of life, which comes every second: the process hangs
_FIRST_SIGN_S = 180.0  # the same before the first one, while it starts and imports its libraries
_STARTS = 3  # of a cluster of ours that has died
_UNWANTED_SILENT_S = 10.0  # the same, where nobody wants the result any more
_NODES_S = 0.5  # between two looks at the nodes of a cluster that was joined
_OWN_NODE_S = 5.0  # the same of our own cluster, whose processes are watched besides
_DEATH_TOLD_S = 20.0  # Ray needs 10 to 15 to notice that a node has died
# light stages first: they are short, and trainings wait for them
_PRIORITY: dict[Role, int] = {"target": 0, "inference": 1, "trainer": 2}


@dataclass(frozen=True)
class _Waiter:
    """Who waits for a result; a run may ask for the same stage twice."""

    run_id: str
    future: Future[StageResult]


@dataclass
class _Job:
    """A stage that somebody waits for."""

    stage: Stage
    number: int
    started_by: str
    waiters: list[_Waiter] = field(default_factory=list[_Waiter])
    attempt: int = 0
    lease: str | None = None  # of the attempt, where it visits the simulated target
    asked: float = field(default_factory=time.time)
    placed: float = 0.0
    losses: int = 0  # attempts whose process was lost
    lost_on: str | None = None  # the node of the last one
    lost_at: float = 0.0  # monotonic
    not_before: float = 0.0  # monotonic; the database was not there
    ref: Any = None  # of the running call
    actor: Actor | None = None
    sign: SignOfLife | None = None
    heard: float = 0.0  # when it came (monotonic)
    is_killed: bool = False  # the process of this attempt, because it was silent
    finished: Finished | None = None  # a result that is not stored yet
    since: float = field(default_factory=time.monotonic)

    @property
    def role(self) -> Role:
        return KINDS[self.stage.kind].role

    @property
    def run_ids(self) -> list[str]:
        return list(dict.fromkeys(waiter.run_id for waiter in self.waiters))

    @property
    def avoid(self) -> str | None:
        """A node that may have died with the last attempt."""
        return self.lost_on if time.monotonic() - self.lost_at < _DEATH_TOLD_S else None

    @property
    def ids(self) -> dict[str, str | int]:
        """For the log."""
        return {
            "run": self.started_by,
            "stage": self.stage.digest,
            "kind": self.stage.kind,
            "attempt": self.attempt,
        }

    def is_wanted_by(self, run_id: str) -> bool:
        return run_id in self.run_ids


@dataclass(frozen=True)
class Activity:
    """A stage in the works, for those who watch."""

    kind: str
    digest: str
    state: str  # "waiting" or "running"
    attempt: int
    seconds: float  # since it was asked for or started
    fraction: float
    facts: dict[str, Any]
    actor: str | None
    actor_id: str | None  # as Ray's dashboard knows it
    pid: int | None
    started_by: str


class Dispatcher:
    """Runs stages for many runs at once. `submit` and `withdraw` may be called by any thread."""

    def __init__(self, options: RayOptions, ledger: Ledger):
        self._options, self._ledger = options, ledger
        self._inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        # of runs, what the database could not be used for; from when on it is tried again
        self._later: list[tuple[str | None, Callable[[], None]]] = []
        self._retry_at = 0.0
        self._jobs: dict[str, _Job] = {}
        self._numbers = 0
        self._stop = threading.Event()
        self._ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._main, name="ray", daemon=True)
        self.cores = 0  # of the whole cluster, as last seen
        self._ticked = time.monotonic()

    def start(self) -> None:
        """Start or join Ray; raises ClusterUnavailable with the reason."""
        self._thread.start()
        self._ready.result()

    def close(self) -> None:
        """Stop everything; what was running will run again when asked for again."""
        self._stop.set()
        if self._thread.ident is not None:  # it was started
            self._thread.join()

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive() and self._ready.done() and not self._stop.is_set()

    @property
    def silent_s(self) -> float:
        """For how long this thread has waited for Ray, or for the database to write."""
        return time.monotonic() - self._ticked

    @property
    def dashboard_url(self) -> str | None:
        return self._cluster.dashboard_url if self._ready.done() else None

    def submit(self, stage: Stage, run_id: str) -> Future[StageResult]:
        """The result to come of a stage, for a run."""
        if self._stop.is_set():
            raise ClusterUnavailable("the dispatcher has stopped; restart the service")
        future: Future[StageResult] = Future()
        self._inbox.put(lambda: self._accept(stage, run_id, future))
        return future

    def withdraw(self, run_id: str) -> None:
        """The run wants nothing any more: its stages go, unless another run wants them."""
        self._inbox.put(lambda: self._withdraw(run_id))

    def arrived(self, digest: str) -> None:
        """A robot's episode has been stored: whoever waits for it may have it."""
        self._inbox.put(lambda: self._arrived(digest))

    def refused(self, digest: str, message: str) -> None:
        """No robot can do an episode, and says why."""
        self._inbox.put(lambda: self._refused(digest, message))

    def activities(self, run_id: str | None = None) -> list[Activity]:
        """What is in the works for a run, or for all, running stages first."""
        now = time.monotonic()
        jobs = list(self._jobs.values())
        mine = [job for job in jobs if run_id is None or job.is_wanted_by(run_id)]
        found = [_activity(job, now) for job in sorted(mine, key=lambda job: job.number)]
        return sorted(found, key=lambda activity: activity.state)  # "running" before "waiting"

    # everything below runs on the dispatcher's own thread

    def _main(self) -> None:
        try:
            self._cluster = Cluster(self._options)
            self._cluster.start()
            self._meet_nodes()
        except Exception as error:  # noqa: BLE001 - whatever it is, the service must hear it
            if (cluster := getattr(self, "_cluster", None)) is not None:
                cluster.close()
            self._ready.set_exception(error)
            return
        self._ready.set_result(None)
        ending: AdrError = RunCancelled("the service is stopping")
        try:
            self._loop()
        except Exception as cause:  # runs must end, and /readyz must tell
            log.exception("the dispatcher stopped")
            ending = ClusterUnavailable(f"the dispatcher stopped: {cause}")
        self._stop.set()
        for job in self._jobs.values():
            _fail(job, ending)
        self._cluster.close()

    def _meet_nodes(self) -> None:
        """Count the cores of a cluster that was just started or joined, and begin a board there."""
        self._slots = Slots(self._options.keep_idle_s)
        self.cores = len(self._slots)
        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)
        board = ray.remote(Board).options(num_cpus=0, max_restarts=-1, scheduling_strategy=here)
        self._board: Any = board.remote()
        self._board_ref: Any = None
        self._board_asked = self._heard_at = self._nodes_seen = time.monotonic()

    def _loop(self) -> None:
        while not self._stop.is_set():
            self._ticked = time.monotonic()
            if not self._cluster.is_alive:  # to ask it anything would block
                self._restart_ray()
            self._read_inbox()
            self._schedule()
            running = {job.ref: job for job in self._jobs.values() if job.ref is not None}
            if running:
                done, _ = ray.wait(list(running), num_returns=len(running), timeout=_TICK_S)
                for ref in done:
                    self._finish(running[ref])
            self._read_board()
            self._end_the_silent()
            self._look_at_nodes()

    def _read_inbox(self) -> None:
        """Carry out what other threads asked for; sleep a tick when nothing runs either."""
        idle = not any(job.ref is not None for job in self._jobs.values())
        while self._later and time.monotonic() >= self._retry_at and not self._stop.is_set():
            _, action = self._later.pop(0)
            action()
        try:
            self._inbox.get(timeout=_TICK_S if idle else 0.001)()
            while True:
                self._inbox.get_nowait()()
        except queue.Empty:
            return

    def _accept(self, stage: Stage, run_id: str, future: Future[StageResult]) -> None:
        job = self._jobs.get(stage.digest)
        if job is None:
            try:
                stored = self._ledger.find(stage, run_id)
            except DatabaseUnavailable as error:
                self._again(lambda: self._accept(stage, run_id, future), error, run_id)
                return
            except Exception as error:  # the database's trouble must not stop other runs
                ids = {"run": run_id, "stage": stage.digest, "kind": stage.kind}
                log.exception("the stage could not be looked up", extra=ids)
                future.set_exception(_not_stored(stage, error))
                return
            if stored is not None:
                future.set_result(stored)
                return
            self._numbers += 1
            job = self._jobs[stage.digest] = _Job(stage, self._numbers, run_id)
        if not job.waiters:
            self._board.set_unwanted.remote(stage.digest, False)
        job.waiters.append(_Waiter(run_id, future))

    def _arrived(self, digest: str) -> None:
        job = self._jobs.get(digest)
        if job is None:  # its run has not asked yet, or does not any more
            return
        try:
            stored = self._ledger.find(job.stage, job.started_by)
        except DatabaseUnavailable as error:
            self._again(lambda: self._arrived(digest), error)
            return
        except Exception as error:  # the database's trouble must not stop other runs
            log.exception("the stage could not be looked up", extra=job.ids)
            self._give_up(job, _not_stored(job.stage, error))
            return
        if stored is not None:
            self._hand_over(job, stored)

    def _refused(self, digest: str, message: str) -> None:
        if (job := self._jobs.get(digest)) is not None:
            self._give_up(job, StageFailed(job.stage.kind, "target_failed", message))

    def _withdraw(self, run_id: str) -> None:
        self._later = [entry for entry in self._later if entry[0] != run_id]
        for digest, job in list(self._jobs.items()):
            if not job.is_wanted_by(run_id):
                continue
            job.waiters = [waiter for waiter in job.waiters if waiter.run_id != run_id]
            if job.waiters:
                continue
            if job.ref is None and job.finished is None:
                self._give_up(job)
            elif job.ref is not None:
                self._board.set_unwanted.remote(digest, True)

    def _schedule(self) -> None:
        if not self._cluster.is_alive:
            return
        jobs = self._jobs.values()
        waiting = [j for j in jobs if j.ref is None and j.finished is None and j.waiters]
        now = time.monotonic()  # robots' roles have no priority
        ours = [job for job in waiting if job.role in _PRIORITY and job.not_before <= now]
        for job in sorted(ours, key=lambda job: (_PRIORITY[job.role], job.number)):
            actor = self._slots.take(job.role, job.started_by, avoid=job.avoid)
            if actor is None or not self._has_begun(job, actor):
                continue
            job.attempt += 1
            job.since, job.placed, job.is_killed = time.monotonic(), time.time(), False
            job.actor, job.ref = actor, actor.handle.compute.remote(job.stage, self._board)
            log.info("stage begun", extra={**job.ids, "actor": actor.name})

    def _has_begun(self, job: _Job, actor: Actor) -> bool:
        """Claim what a process is about to do; where that cannot be, the process is free again."""
        try:
            job.lease = self._ledger.begin(job.stage, job.started_by, actor.name)
        except DatabaseUnavailable as error:
            log.warning("%s; trying again in %g s", error, RETRY_S, extra=job.ids)
            job.not_before = time.monotonic() + RETRY_S
        except Exception as error:  # the database's trouble must not stop other runs
            log.exception("the stage could not be begun", extra=job.ids)
            self._give_up(job, _not_stored(job.stage, error))
        else:
            return True
        self._slots.give_back(actor)
        return False

    def _finish(self, job: _Job) -> None:
        ref, actor = job.ref, job.actor
        assert actor is not None
        job.ref, job.actor, job.sign = None, None, None
        try:
            ending = cast(Ending, ray.get(ref))
        except RayTaskError as error:  # it raised where only a defect of ours can
            ending: Ending = Failed("internal", str(error))
        except RayError as error:
            self._lost(job, actor, error)
            return
        self._slots.give_back(actor)
        match ending:
            case Finished():
                job.finished = ending
                self._deliver(job)
            case Failed(code, message):
                self._give_up(job, StageFailed(job.stage.kind, code, message))
            case Stopped():
                if not job.waiters:
                    self._give_up(job)
                # else it was wanted again while it was stopping, and waits for its turn

    def _deliver(self, job: _Job) -> None:
        """Commit a result, then hand it to those who wait; later, while nothing can be stored."""
        finished = job.finished
        assert finished is not None
        try:
            attempt = Attempt(
                job.attempt, job.started_by, job.asked, job.placed, self.cores, job.lease
            )
            self._ledger.commit(job.stage, finished, attempt, job.run_ids)
        except DatabaseUnavailable as error:
            self._again(lambda: self._deliver(job), error)
            return
        except Exception as error:  # the database's trouble must not stop other runs
            log.exception("the stage's result could not be stored", extra=job.ids)
            self._give_up(job, _not_stored(job.stage, error))
            return
        log.info("stage finished", extra=job.ids)
        self._hand_over(job, finished.result)

    def _hand_over(self, job: _Job, result: StageResult) -> None:
        del self._jobs[job.stage.digest]
        for waiter in job.waiters:
            waiter.future.set_result(result)

    def _give_up(self, job: _Job, error: AdrError | None = None) -> None:
        """The end of a job, without a result."""
        del self._jobs[job.stage.digest]
        if error is not None:
            log.warning("stage failed: %s", error, extra=job.ids)
            _fail(job, error)
        if job.lease is not None:
            self._drop(job.stage)

    def _drop(self, stage: Stage) -> None:
        if stage.digest in self._jobs:  # it was asked for again
            return
        try:
            self._ledger.drop(stage)
        except DatabaseUnavailable as error:
            self._again(lambda: self._drop(stage), error)
        except Exception:  # the database's trouble must not stop other runs
            log.exception(
                "the claim of a stage without a result stays", extra={"stage": stage.digest}
            )

    def _again(
        self, action: Callable[[], None], error: DatabaseUnavailable, run_id: str | None = None
    ) -> None:
        """Do something once more a little later, for a run if it is still wanted then."""
        log.warning("%s; trying again in %g s", error, RETRY_S)
        self._later.append((run_id, action))
        self._retry_at = time.monotonic() + RETRY_S

    def _lost(self, job: _Job, actor: Actor, error: RayError) -> None:
        """A process died under a job: another attempt, or the end."""
        log.warning("stage lost: %s", error, extra=job.ids)
        self._slots.lose(actor)
        self._nodes_seen = 0.0  # its node may be gone as well
        job.lost_on, job.lost_at = actor.slot.node, time.monotonic()
        self._count_loss(job, str(error))

    def _count_loss(self, job: _Job, why: str) -> None:
        job.losses += 1
        if not job.waiters:
            self._give_up(job)
        elif job.losses >= MAX_ATTEMPTS:
            detail = f"its process was lost {MAX_ATTEMPTS} times; last: {why}"
            self._give_up(job, StageFailed(job.stage.kind, "worker_lost", detail))

    def _read_board(self) -> None:
        """Ask the board for news now and then, never waiting for it."""
        since = time.monotonic() - self._board_asked
        if self._board_ref is None:
            if since > _READ_BOARD_S:
                self._board_asked = time.monotonic()
                self._board_ref = self._board.news.remote()
            return
        done, _ = ray.wait([self._board_ref], timeout=0)
        if not done:
            if since > _UNWANTED_SILENT_S:  # before those that report there seem silent
                log.warning("the board: no answer for %.0f s", since)
                self._board_ref = None
                ray.kill(self._board, no_restart=False)
            return
        reference, self._board_ref = self._board_ref, None
        try:
            signs, found = cast(tuple[list[SignOfLife], dict[str, SoFar]], ray.get(reference))
        except RayError as error:  # its process was lost; Ray starts another
            log.warning("the board was lost: %s", error)
            return
        self._heard_at = self._board_asked
        for sign in signs:
            if (job := self._jobs.get(sign.digest)) is not None:
                job.sign, job.heard = sign, time.monotonic()
        for digest, so_far in found.items():
            if (job := self._jobs.get(digest)) is not None and job.waiters:
                self._note_so_far(job, so_far)

    def _look_at_nodes(self) -> None:
        """Follow nodes that come and go; our own, which does not, hangs where it is not seen."""
        if not self._cluster.is_alive:
            return
        every = _OWN_NODE_S if self._cluster.is_local else _NODES_S
        if time.monotonic() - self._nodes_seen < every:
            return
        self._nodes_seen = time.monotonic()
        self._slots.refresh()
        self.cores = len(self._slots)
        if self._slots.nodes == 0 and self._cluster.is_local:
            self._restart_ray()

    def _restart_ray(self) -> None:
        """Our own cluster has died: start another, and what was running again."""
        for start in range(1, _STARTS + 1):
            log.warning("Ray has died; starting it again")
            try:
                self._cluster.restart()
                self._meet_nodes()
                break
            except (ClusterUnavailable, RayError) as error:
                log.warning("Ray did not start again: %s", error)
                if start == _STARTS:
                    raise
        for job in [job for job in self._jobs.values() if job.ref is not None]:
            job.ref, job.actor, job.sign = None, None, None
            self._count_loss(job, "Ray has died")

    def _end_the_silent(self) -> None:
        """Kill processes that hang, also before their first sign; they are lost like any other."""
        for job in self._jobs.values():
            if job.actor is None or job.is_killed:
                continue
            # as the board knew it: this thread may have waited for the database since
            silent = self._heard_at - max(job.heard, job.since)
            patience = _FIRST_SIGN_S if job.sign is None else _SILENT_S
            if silent > (patience if job.waiters else _UNWANTED_SILENT_S):
                log.warning("%s: no sign of life for %.0f s", job.actor.name, silent, extra=job.ids)
                job.is_killed = True
                ray.kill(job.actor.handle)

    def _note_so_far(self, job: _Job, so_far: SoFar) -> None:
        try:
            self._ledger.note(job.stage, so_far, job.run_ids)
        except DatabaseUnavailable as error:
            log.warning("what the stage has so far is not stored: %s", error, extra=job.ids)
        except Exception:  # the result will be stored, or fail, by itself
            log.exception("what the stage has so far could not be stored", extra=job.ids)


def _activity(job: _Job, now: float) -> Activity:
    # the dispatcher may change the job meanwhile: each field is read once
    sign, actor, ref = job.sign, job.actor, job.ref
    return Activity(
        kind=job.stage.kind,
        digest=job.stage.digest,
        state="waiting" if ref is None else "running",
        attempt=job.attempt,
        seconds=now - job.since,
        fraction=sign.fraction if sign else 0.0,
        facts=sign.facts if sign else {},
        actor=actor.name if actor else None,
        actor_id=sign.actor_id if sign else None,
        pid=sign.pid if sign else None,
        started_by=job.started_by,
    )


def _fail(job: _Job, error: AdrError) -> None:
    for waiter in job.waiters:
        if not waiter.future.done():
            waiter.future.set_exception(error)


def _not_stored(stage: Stage, error: Exception) -> StageFailed:
    return StageFailed(stage.kind, "not_stored", f"the database refused: {error}")

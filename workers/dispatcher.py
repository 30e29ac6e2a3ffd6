"""Places stages on cores; the one thread that talks to Ray.

    dispatcher = Dispatcher(RayOptions(cpus=2), DatabaseResults(database))
    dispatcher.start()                                  # ClusterUnavailable with the reason
    dispatcher.submit(stage, run_id).result()           # a StageResult, or StageFailed

Each core computes one stage at a time (see `workers.pool`); what becomes of a stage stands in
`workers.job_table`. `ray.init` and everything after it happen on one thread that lives as long as
the service: Ray's processes die with the thread that started them, and on the main thread Ray
would steal signals.
"""

import itertools
import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import cast

import ray
from ray.exceptions import ObjectStoreFullError, OutOfDiskError, RayError, RayTaskError

from adr_service.benchmark.cost import Execution
from adr_service.errors import AdrError, FailureCode, InvalidInput, RunCancelled
from adr_service.stages.base import AnyStage, StageResult
from workers.actors import Ending, Failed
from workers.cluster import Cluster, ClusterUnavailable, RayOptions
from workers.demand import Demand
from workers.heartbeats import UNWANTED_S, UNWANTED_SILENT_S, Heartbeats, patience_s
from workers.job_table import AT_ONCE, JobTable
from workers.jobs import Activity, Job
from workers.pool import Actor, Pool
from workers.results import Results, outages

log = logging.getLogger(__name__)
_TICK_S = 0.05
_STARTS = 3  # of a cluster of ours that has died
_AGAIN_S = 3.0  # between two attempts at a start
_NODES_S = 0.5  # between two looks at the nodes of a cluster that was joined
_OWN_NODE_S = 5.0  # the same for our own cluster, whose processes are watched as well


class Dispatcher:
    """Runs stages for many runs at once. Any thread may call the functions without underscore."""

    def __init__(
        self,
        options: RayOptions,
        results: Results,
        cluster: Callable[[RayOptions], Cluster] = Cluster,
    ):
        self._options, self._make_cluster = options, cluster
        self._inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._jobs = JobTable(results)
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
        """Stop everything; running stages run again when a run asks for them again."""
        self._stop.set()
        if self._thread.ident is not None:  # it was started
            self._thread.join()

    @property
    def is_alive(self) -> bool:
        """True if stages can be submitted, and will be placed."""
        return self._thread.is_alive() and self._ready.done() and not self._stop.is_set()

    @property
    def silent_s(self) -> float:
        """Seconds for which this thread has waited for Ray, or for the database to write."""
        return time.monotonic() - self._ticked

    @property
    def dashboard_url(self) -> str | None:
        """Address of Ray's dashboard, once Ray has started."""
        return self._cluster.dashboard_url if self._ready.done() else None

    def submit(self, stage: AnyStage, run_id: str) -> Future[StageResult]:
        """Ask for a stage's result, for a run.

        Raises InvalidInput for inputs that are no JSON: here, so that the run that asks ends alone.
        """
        _check_inputs(stage)
        if self._stop.is_set():
            raise ClusterUnavailable("the dispatcher has stopped; restart the service")
        future: Future[StageResult] = Future()
        self._inbox.put(lambda: self._jobs.accept(stage, run_id, future))
        return future

    def withdraw(self, run_id: str) -> None:
        """Forget a run's requests; a stage that no other run wants stops."""
        self._inbox.put(lambda: self._jobs.withdraw(run_id))

    def arrived(self, digest: str) -> None:
        """Hand over a robot's episode, which has been stored, to the run that waits for it."""
        self._inbox.put(lambda: self._jobs.arrived(digest))

    def refused(self, digest: str, message: str) -> None:
        """Fail a robot's episode that no robot can do."""
        self._inbox.put(lambda: self._jobs.refused(digest, message))

    def activities(self, run_id: str | None = None) -> list[Activity]:
        """Stages that a run waits for, or all runs; running stages first."""
        return self._jobs.activities(run_id)

    # everything below runs on the dispatcher's own thread

    def _main(self) -> None:
        try:
            self._start_ray()
        except Exception as error:  # noqa: BLE001 - whatever it is, the service must hear it
            self._ready.set_exception(error)
            return
        self._ready.set_result(None)
        ending: AdrError = RunCancelled("the service is stopping")
        try:
            self._loop()
        except Exception as cause:  # runs must end, and /readyz must say so
            log.exception("the dispatcher stopped")
            ending = ClusterUnavailable(f"the dispatcher stopped: {cause}")
        self._stop.set()
        self._jobs.fail_all(ending)
        if self._cluster.is_alive:
            self._demand.report(0)  # the request outlives this process
        self._cluster.close()

    def _start_ray(self) -> None:
        self._cluster = self._make_cluster(self._options)
        try:
            self._cluster.start()
            self._meet_nodes()
        except BaseException:
            self._cluster.close()
            raise

    def _meet_nodes(self) -> None:
        """Count the cores of a cluster that was just started or joined, and start a board there."""
        self._pool, self._demand = Pool(self._options), Demand(self._options)
        self.cores = len(self._pool)
        self._heartbeats = Heartbeats()
        self._nodes_seen = time.monotonic()

    def _loop(self) -> None:
        while not self._stop.is_set():
            self._step()
            self._wait()

    def _step(self) -> None:
        """One round, which waits for nobody but the database."""
        self._ticked = time.monotonic()
        if not self._cluster.is_alive:  # any question to it would block
            self._restart_ray()
            return
        self._jobs.retries.run_due(self._stop.is_set)
        self._read_inbox()
        self._place_jobs()
        self._collect()
        self._listen()
        self._kill_stuck()
        self._look_at_nodes()

    def _wait(self) -> None:
        """Wait a tick at most, for all running calls to end or, without any, for another thread."""
        running = [job.ref for job in self._jobs.running()]
        if running and self._cluster.is_alive:
            ray.wait(running, num_returns=len(running), timeout=_TICK_S)
        else:
            with suppress(queue.Empty):
                self._inbox.get(timeout=_TICK_S)()

    def _read_inbox(self) -> None:
        """Carry out what other threads asked for.

        A service that stops leaves the rest: each may wait for the database.
        """
        with suppress(queue.Empty):
            while not self._stop.is_set():
                self._inbox.get_nowait()()

    def _place_jobs(self) -> None:
        """Give free cores to jobs that wait for one."""
        if not self._cluster.is_alive:
            return
        taken = self._take_cores()
        for first in range(0, len(taken), AT_ONCE):
            jobs, actors = zip(*taken[first : first + AT_ONCE], strict=True)
            are_begun = self._jobs.begin(jobs, [actor.name for actor in actors])
            for job, actor, is_begun in zip(jobs, actors, are_begun, strict=True):
                if is_begun:
                    self._place(job, actor)
                else:
                    self._pool.give_back(actor)

    def _take_cores(self) -> list[tuple[Job, Actor]]:
        """Jobs that wait for a core, each with an actor on a free one."""
        taken = list[tuple[Job, Actor]]()
        for job in self._jobs.ready():
            actor = self._pool.take(job.role, job.started_by, job.avoid, newer_than=job.lost_at)
            if actor is not None:
                taken.append((job, actor))
            elif job.avoid is None:
                break  # no core is free for any other job either
        return taken

    def _place(self, job: Job, actor: Actor) -> None:
        now = time.time()
        placed = Execution(
            attempt=job.attempt,
            started_by=job.started_by,
            asked=job.asked,
            placed=now,
            began=now,
            ended=now,
            cores=self.cores,
        )
        try:
            ref = actor.handle.compute.remote(job.stage, placed, self._heartbeats.board)
        except (ObjectStoreFullError, OutOfDiskError) as error:  # which passes
            outages.warning("the stage could not be sent just now: %s", error, extra=job.ids)
            self._pool.give_back(actor)
            job.postpone()
        except RayError as error:
            log.warning("the stage could not be sent: %s", error, extra=job.ids)
            self._pool.give_back(actor)
            job.postpone()
            self._jobs.lose(job, str(error), actor.core.node)
        except Exception as error:  # noqa: BLE001 - a method may hold what cannot be packed
            self._pool.give_back(actor)
            why = f"its inputs cannot be pickled for another process: {error.__cause__ or error}"
            self._jobs.end([(job, Failed(FailureCode.INTERNAL, why))])
        else:
            job.place(actor, ref)
            log.info("stage begun", extra={**job.ids, "actor": actor.name})

    def _collect(self) -> None:
        """Take up what actors have finished."""
        running = {job.ref: job for job in self._jobs.running()}
        if running:
            done, _ = ray.wait(list(running), num_returns=len(running), timeout=0)
            endings = [(running[ref], self._leave(running[ref])) for ref in done]
            self._jobs.end([(job, ending) for job, ending in endings if ending is not None])

    def _leave(self, job: Job) -> Ending | None:
        """The ending of a job that its actor has left; None if the process was lost."""
        ref, actor = job.ref, job.actor
        assert actor is not None
        job.leave()
        try:
            ending = cast(Ending, ray.get(ref))
        except RayTaskError as error:
            ending = _not_computed(error)
        except RayError as error:
            self._lose(job, actor, error)
            return None
        self._pool.give_back(actor)
        return ending

    def _lose(self, job: Job, actor: Actor, error: RayError) -> None:
        """Note that a process died under a job."""
        log.warning("stage lost: %s", error, extra=job.ids)
        self._pool.lose(actor)
        self._nodes_seen = 0.0  # its node may be gone as well
        self._jobs.lose(job, str(error), actor.core.node)

    def _listen(self) -> None:
        signs, checkpoints = self._heartbeats.news(self._jobs.unwanted())
        for sign in signs:
            self._jobs.hear(sign)
        for digest, checkpoint in checkpoints.items():
            self._jobs.note(digest, checkpoint)

    def _kill_stuck(self) -> None:
        """Kill processes that hang, also before their first sign, and those that compute on though
        no run wants their stage; they are lost like any other."""
        for job in self._jobs.running():
            if job.actor is None or job.is_killed:
                continue
            silent = self._heartbeats.silence(max(job.heard_at, job.since))
            if silent > patience_s(job.sign, len(job.waiters)):
                why = f"no sign of life for {silent:.0f} s"
            elif job.unwanted_since is not None and self._goes_on_unwanted(job.unwanted_since):
                why = f"no run has wanted its stage for {UNWANTED_S:.0f} s, and it computes on"
            else:
                continue
            log.warning("%s: %s", job.actor.name, why, extra=job.ids)
            job.is_killed = True
            ray.kill(job.actor.handle)

    def _goes_on_unwanted(self, since: float) -> bool:
        """True if a stage that no run has wanted since `since` (monotonic) did not stop in time.

        It has `UNWANTED_S` up to the board's last answer, from which its process learns that, and
        at most `UNWANTED_SILENT_S` more while the board is silent.
        """
        knows = self._heartbeats.silence(since) > UNWANTED_S
        return knows or time.monotonic() - since > UNWANTED_S + UNWANTED_SILENT_S

    def _look_at_nodes(self) -> None:
        """Follow nodes that come and go; our own node stays, and looking at it takes a while."""
        every = _OWN_NODE_S if self._cluster.is_local else _NODES_S
        if time.monotonic() - self._nodes_seen < every or not self._cluster.is_alive:
            return
        self._nodes_seen = time.monotonic()
        self._pool.refresh()
        self.cores = len(self._pool)
        self._demand.report(len(self._jobs.ready()) + len(self._jobs.running()))
        if not self._pool.is_at_home:
            self._restart_ray()

    def _restart_ray(self) -> None:
        """Start another cluster after the death of our own, or wait for one that was joined.

        Running stages are lost.
        """
        log.warning("Ray has died; %s", self._cluster.remedy)
        for start in itertools.count(1):
            try:
                self._cluster.restart()
                self._meet_nodes()
                break
            except (ClusterUnavailable, RayError) as error:
                log.warning("there is no Ray again yet: %s", error)
                if self._cluster.is_local and start == _STARTS:
                    raise
                if self._stop.wait(_AGAIN_S):
                    return
        log.info("there is a Ray again, of %d cores", self.cores)
        for job in self._jobs.running():
            log.warning("stage lost: Ray has died", extra=job.ids)
            job.leave()
            self._jobs.lose(job, "Ray has died")


def _check_inputs(stage: AnyStage) -> None:
    """Compute the digest, which the stage keeps."""
    try:
        _ = stage.digest
    except (TypeError, ValueError, RecursionError) as error:  # as from a method's state
        raise InvalidInput(f"an input of {stage.kind} is no JSON: {error}") from error


def _not_computed(error: RayTaskError) -> Failed:
    """The failure of a stage that its process could not even unpack, or a defect of ours."""
    is_lacking = "ModuleNotFoundError" in str(error)  # a method's package, on the node
    code = FailureCode.UNKNOWN_NAME if is_lacking else FailureCode.INTERNAL
    return Failed(code, str(error))

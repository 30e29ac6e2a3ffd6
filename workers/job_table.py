"""The table of jobs: the runs that wait for each, the order, and how each ends.

    table = JobTable(results)
    table.accept(stage, run_id, future)         # equal stages are one job
    for job in table.ready(): ...               # to be placed on a core: begin, then end or lose

A process that is lost means another attempt, three at most. Nothing here asks Ray, and all but
`activities` runs on the dispatcher's thread.
"""

import itertools
import logging
import time
from collections.abc import Sequence
from concurrent.futures import Future

from adr_service.errors import AdrError, FailureCode, StageFailed, target_failed
from adr_service.progress import Checkpoint
from adr_service.stages.base import PRIORITY, AnyStage, StageResult
from workers.actors import Ending, Failed, Finished, Stopped
from workers.heartbeats import SignOfLife
from workers.jobs import Activity, Job, Waiter, activity_of, ids_of
from workers.results import Beginning, Outcome, Refused, Results, Retries, Unavailable, attempted

log = logging.getLogger(__name__)
MAX_ATTEMPTS = 3
AT_ONCE = 50  # stages that one transaction changes, so that others can write between two
_NOT_LOOKED_UP = "the stage could not be looked up"


class JobTable:
    """All jobs; those that end leave."""

    def __init__(self, results: Results):
        self._results = results
        self.retries = Retries()
        self._jobs: dict[str, Job] = {}
        self._wanted: dict[str, dict[str, Job]] = {}  # by run that waits, then by digest
        self._numbers = itertools.count(1)

    def __len__(self) -> int:
        return len(self._jobs)

    def ready(self) -> list[Job]:
        """Jobs that wait for a core, in the order in which they should have one."""
        waiting = [job for job in self._jobs.values() if job.is_waiting]
        return sorted(waiting, key=lambda job: (PRIORITY[job.role], job.number))

    def running(self) -> list[Job]:
        """Jobs that an actor computes."""
        return [job for job in self._jobs.values() if job.ref is not None]

    def unwanted(self) -> frozenset[str]:
        """Digests of the stages that an actor computes and no run wants any more."""
        return frozenset(job.stage.digest for job in self.running() if not job.waiters)

    def activities(self, run_id: str | None = None) -> list[Activity]:
        """Jobs of a run, or all, for people; running ones first. Any thread may ask."""
        now = time.monotonic()
        mine = self._jobs if run_id is None else self._wanted.get(run_id, {})
        jobs = list(mine.values())
        shown = [activity_of(job, now) for job in sorted(jobs, key=lambda job: job.number)]
        return sorted(shown, key=lambda activity: activity.state)  # "running" before "waiting"

    def accept(self, stage: AnyStage, run_id: str, future: Future[StageResult]) -> None:
        """Let a run have a stage's stored result, or wait for it."""
        waiter, job = Waiter(run_id, future), self._jobs.get(stage.digest)
        # a robot's is looked up again, because its visit was withdrawn if the run had failed
        if job is not None and stage.role != "robot":
            self._add(job, waiter)
            return
        ids = ids_of(stage, run_id)
        match attempted(_NOT_LOOKED_UP, ids, self._results.find, stage, run_id):
            case Unavailable():
                self.retries.add(lambda: self.accept(stage, run_id, future), run_id)
            case Refused(error):
                future.set_exception(_not_stored(stage, error))
            case None:
                if job is None:
                    job = Job(stage, next(self._numbers), run_id, asked=time.time())
                    self._jobs[stage.digest] = job
                self._add(job, waiter)
            case result:
                future.set_result(result)

    def withdraw(self, run_id: str) -> None:
        """Forget a run's requests; a stage that no other run wants stops."""
        self.retries.withdraw(run_id)
        for job in self._wanted.pop(run_id, {}).values():
            job.withdraw(run_id)
            if not job.waiters and job.ref is None and job.finished is None:
                self._give_up(job)

    def arrived(self, digest: str) -> None:
        """Hand over a robot's episode, whose result somebody else has stored."""
        job = self._jobs.get(digest)
        if job is None:  # its run has not asked yet, or does not any more
            return
        stage, find = job.stage, self._results.find
        match attempted(_NOT_LOOKED_UP, job.ids, find, stage, job.started_by):
            case Unavailable():
                self.retries.add(lambda: self.arrived(digest))
            case Refused(error):
                self._give_up(job, _not_stored(stage, error))
            case None:
                pass  # it was deleted since
            case result:
                self._hand_over(job, result)

    def refused(self, digest: str, message: str) -> None:
        """Fail a robot's episode that no robot can do."""
        if (job := self._jobs.get(digest)) is not None:
            self._give_up(job, target_failed(job.stage.kind, message))

    def begin(self, jobs: Sequence[Job], workers: Sequence[str]) -> list[bool]:
        """Begin an attempt of each job, under a lease if it needs one; False where it cannot be."""
        beginnings = [
            Beginning(job.stage, job.started_by, worker)
            for job, worker in zip(jobs, workers, strict=True)
        ]
        for job in jobs:
            job.may_be_claimed = True
        trouble, ids = "stages could not be begun", _ids_of(jobs)
        match attempted(trouble, ids, self._results.begin, beginnings):
            case Unavailable():
                for job in jobs:
                    job.postpone()
            case Refused(error) if len(jobs) == 1:
                self._give_up(jobs[0], _not_stored(jobs[0].stage, error))
            case Refused():  # because of one of them
                pairs = zip(jobs, workers, strict=True)
                return [is_begun for job, name in pairs for is_begun in self.begin([job], [name])]
            case leases:
                for job, lease in zip(jobs, leases, strict=True):
                    job.lease, job.attempt = lease, job.attempt + 1
                return [True] * len(jobs)
        return [False] * len(jobs)

    def hear(self, sign: SignOfLife) -> None:
        """Note a sign of life of the attempt that goes on; a lost process may have left one."""
        job = self._jobs.get(sign.digest)
        if job is not None and job.ref is not None and job.attempt == sign.attempt:
            job.sign, job.heard_at = sign, time.monotonic()

    def note(self, digest: str, checkpoint: Checkpoint) -> None:
        """Store a training's checkpoint, if a run waits for it; its result does not need that."""
        job = self._jobs.get(digest)
        if job is not None and job.waiters:
            trouble = "the stage's checkpoint could not be stored"
            attempted(trouble, job.ids, self._results.note, job.stage, checkpoint, job.run_ids)

    def end(self, endings: Sequence[tuple[Job, Ending]]) -> None:
        """Store and hand over what actors computed, or fail the stages."""
        finished = list[Job]()
        for job, ending in endings:
            match ending:
                case Finished():
                    job.finished = ending
                    finished.append(job)
                case Failed(code, message):
                    self._give_up(job, StageFailed(job.stage.kind, code, message))
                case Stopped():
                    if not job.waiters:
                        self._give_up(job)
                    # else it was wanted again while it was stopping, and waits for its turn
        for first in range(0, len(finished), AT_ONCE):
            self._deliver(finished[first : first + AT_ONCE])

    def lose(self, job: Job, why: str, node: str | None = None) -> None:
        """Count a lost process, on a node if that is known: the job waits again, or fails."""
        job.lose(node)
        if not job.waiters:
            self._give_up(job)
        elif job.losses >= MAX_ATTEMPTS:
            detail = f"its process was lost {MAX_ATTEMPTS} times; last: {why}"
            self._give_up(job, StageFailed(job.stage.kind, FailureCode.WORKER_LOST, detail))

    def fail_all(self, error: AdrError) -> None:
        """Raise an error in all runs that wait."""
        for job in self._jobs.values():
            job.fail(error)

    def _deliver(self, jobs: Sequence[Job]) -> None:
        """Store results, then hand them to the runs that wait; later, while that cannot be."""
        outcomes = [_outcome(job) for job in jobs]
        trouble, ids = "results of stages could not be stored", _ids_of(jobs)
        match attempted(trouble, ids, self._results.commit, outcomes):
            case Unavailable():
                self.retries.add(lambda: self._deliver(jobs))
            case Refused(error) if len(jobs) == 1:
                self._give_up(jobs[0], _not_stored(jobs[0].stage, error))
            case Refused():  # because of one of them
                for job in jobs:
                    self._deliver([job])
            case stored:
                for job, result in zip(jobs, stored, strict=True):
                    log.info("stage finished", extra=job.ids)
                    self._hand_over(job, result)

    def _add(self, job: Job, waiter: Waiter) -> None:
        job.add(waiter)
        self._wanted.setdefault(waiter.run_id, {})[job.stage.digest] = job

    def _remove(self, job: Job) -> None:
        """Forget a job that ends."""
        del self._jobs[job.stage.digest]
        for run_id in job.run_ids:
            wanted = self._wanted[run_id]
            del wanted[job.stage.digest]
            if not wanted:
                del self._wanted[run_id]

    def _hand_over(self, job: Job, result: StageResult) -> None:
        self._remove(job)
        for waiter in job.waiters:
            waiter.future.set_result(result)

    def _give_up(self, job: Job, error: AdrError | None = None) -> None:
        """End a job without a result."""
        self._remove(job)
        if error is not None:
            log.warning("stage failed: %s", error, extra=job.ids)
            job.fail(error)
        if job.may_be_claimed:
            self._drop(job.stage, job.ids)

    def _drop(self, stage: AnyStage, ids: dict[str, str | int]) -> None:
        if stage.digest in self._jobs:  # a run asked for it again
            return
        trouble = "the claim of a stage without a result could not be dropped"
        if attempted(trouble, ids, self._results.drop, stage) == Unavailable():
            self.retries.add(lambda: self._drop(stage, ids))


def _ids_of(jobs: Sequence[Job]) -> dict[str, str | int]:
    """The names of a job in the log; several jobs have none, because any may be in trouble."""
    return jobs[0].ids if len(jobs) == 1 else {}


def _outcome(job: Job) -> Outcome:
    assert job.finished is not None
    result, execution = job.finished.result, job.finished.execution
    return Outcome(job.stage, result, execution, job.lease, job.run_ids)


def _not_stored(stage: AnyStage, error: Exception) -> StageFailed:
    return StageFailed(stage.kind, FailureCode.NOT_STORED, f"the database refused: {error}")

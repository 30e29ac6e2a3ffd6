"""Stages that runs wait for, and what people see of them.

A job lasts from a stage's first request to its result or failure; equal stages are one job. It is
changed by the dispatcher's thread alone (`JobTable`).
"""

import time
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from adr_service.errors import AdrError
from adr_service.json_values import Wire
from adr_service.stages.base import PRIORITY, AnyStage, Role, StageResult
from db.session import RETRY_S
from workers.actors import Finished
from workers.heartbeats import SignOfLife
from workers.pool import Actor

_DEATH_SEEN_S = 20.0  # Ray needs 10 to 15 to notice that a node has died


@dataclass(frozen=True)
class Waiter:
    """A run's wait for a result; a run may ask for the same stage twice."""

    run_id: str
    future: Future[StageResult]


@dataclass
class Job:
    """A stage that runs wait for, and its present attempt. Times are monotonic but for `asked`."""

    stage: AnyStage
    number: int  # order of the first requests
    started_by: str  # id of the run that asked first
    asked: float  # when that was
    waiters: list[Waiter] = field(default_factory=list[Waiter])
    attempt: int = 0
    lease: str | None = None  # of the attempt, if it visits the simulated target
    may_be_claimed: bool = False  # a claim may be stored though its answer was lost
    ref: Any = None  # of the running call
    actor: Actor | None = None  # the process that computes it
    since: float = field(default_factory=time.monotonic)  # start of the wait, or of the attempt
    sign: SignOfLife | None = None  # the last one of the attempt
    heard_at: float = 0.0  # when that came
    unwanted_since: float | None = None  # when the last run ceased to want it, if none does
    is_killed: bool = False  # the process of the attempt, because it was silent or did not stop
    finished: Finished | None = None  # a result that is not stored yet
    losses: int = 0  # attempts whose process was lost
    lost_on: str | None = None  # the node of the last one
    lost_at: float = 0.0
    not_before: float = 0.0  # a moment to which it is postponed

    @property
    def role(self) -> Role:
        """Role of the actors that can compute the stage."""
        return self.stage.role

    @property
    def run_ids(self) -> list[str]:
        """Runs that wait for it, each once."""
        return list(dict.fromkeys(waiter.run_id for waiter in self.waiters))

    @property
    def avoid(self) -> str | None:
        """A node that may have died with the last attempt."""
        return self.lost_on if time.monotonic() - self.lost_at < _DEATH_SEEN_S else None

    @property
    def is_waiting(self) -> bool:
        """True if it waits for a core of ours, and may have one now."""
        idle = self.ref is None and self.finished is None and self.role in PRIORITY
        return idle and bool(self.waiters) and self.not_before <= time.monotonic()

    @property
    def ids(self) -> dict[str, str | int]:
        """Names of the job in the log."""
        return {**ids_of(self.stage, self.started_by), "attempt": self.attempt}

    def add(self, waiter: Waiter) -> None:
        """Let one more run wait."""
        self.waiters.append(waiter)
        self.unwanted_since = None

    def withdraw(self, run_id: str) -> None:
        """Let a run wait no more."""
        self.waiters = [waiter for waiter in self.waiters if waiter.run_id != run_id]
        if not self.waiters:
            self.unwanted_since = time.monotonic()

    def place(self, actor: Actor, ref: Any) -> None:
        """Note that an actor computes the attempt, as the call `ref`."""
        self.actor, self.ref, self.is_killed = actor, ref, False
        self.since = time.monotonic()

    def leave(self) -> None:
        """Note that nobody computes it any more."""
        self.actor, self.ref, self.sign = None, None, None
        self.since = time.monotonic()

    def postpone(self) -> None:
        """Let it wait for `RETRY_S`, because the database, or Ray, cannot be used just now."""
        self.not_before = time.monotonic() + RETRY_S

    def lose(self, node: str | None) -> None:
        """Count a process that was lost under it, on a node that it avoids for a while."""
        self.losses += 1
        self.lost_on, self.lost_at = node, time.monotonic()

    def fail(self, error: AdrError) -> None:
        """Raise an error in all runs that wait."""
        for waiter in self.waiters:
            if not waiter.future.done():
                waiter.future.set_exception(error)


class Activity(Wire):
    """A stage that is being computed or waits for a core."""

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


def activity_of(job: Job, now: float) -> Activity:
    """The job as people see it, at a monotonic time; any thread may ask."""
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


def ids_of(stage: AnyStage, run_id: str) -> dict[str, str | int]:
    """Names of a stage in the log."""
    return {"run": run_id, "stage": stage.digest, "kind": stage.kind}

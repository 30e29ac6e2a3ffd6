"""The store of results, events and visits: dictionaries, or the service's database.

Both are written by one dispatcher at a time, and by runs and robots.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Protocol

from adr_service.benchmark.cost import Execution
from adr_service.events import (
    RunEvent,
    RunFailed,
    RunStarted,
    RunState,
    RunStopped,
    RunSucceeded,
    StageFinished,
)
from adr_service.progress import Checkpoint
from adr_service.stages.base import AnyStage, StageResult
from db import events as event_store
from db import runs as run_store
from db import stages as stage_store
from db import visits as visit_store
from db.models import Base
from db.session import Database
from db.visits import LeaseLost
from tests.db.rows import SPEC
from workers.results import Beginning, DatabaseResults, Outcome, Results

_TASK = "arm"
_EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
_MOST_S = 4e9  # after the epoch, in some distant year
_OPEN = ("pending", "claimed")


@dataclass(frozen=True)
class Claim:
    """A robot's claim of an episode."""

    id: str
    digest: str
    lease: str


class Ledger(Results, Protocol):
    """The store of a service."""

    def submit(self) -> str:
        """The id of a new run."""
        ...

    def begin_run(self, run_id: str, submission: int) -> None: ...

    def end_run(self, run_id: str, submission: int, state: RunState) -> None: ...

    def resubmit(self, run_id: str) -> None: ...

    def forget_unclaimed(self) -> None:
        """Forget what no robot has claimed, as a service does that starts."""
        ...

    def claim(self, robot: str, now: float, lease_s: float) -> Claim | None: ...

    def complete(self, claim: Claim, stage: AnyStage, result: StageResult, now: float) -> None:
        """Accept an episode. Raises LeaseLost."""
        ...

    def refuse(self, claim: Claim) -> None:
        """Note that no robot can do it. Raises LeaseLost."""
        ...

    def executions(self) -> list[Execution]:
        """The measured executions of stored stages."""
        ...

    def stored(self, digests: Sequence[str]) -> set[str]:
        """The digests among these that have a result."""
        ...

    def finished(self, run_id: str) -> list[str]:
        """Digests of the stages that have finished by the run's events, one for each event."""
        ...

    def claimed(self) -> list[str]:
        """Digests of visits that the simulated target has claimed."""
        ...


@dataclass
class _Visit:
    """A row of `target_tasks`."""

    run_id: str
    is_external: bool
    state: str
    lease: str | None = None
    expires: float = 0.0


class MemoryLedger:
    """A ledger of dictionaries, with the fences of `db.stages` and `db.visits`."""

    def __init__(self) -> None:
        self._results: dict[str, StageResult] = {}
        self._executions: dict[str, Execution] = {}
        self._events: dict[str, dict[str, None]] = {}
        self._visits: dict[str, _Visit] = {}
        self._live: set[str] = set()
        self._leases, self._runs = itertools.count(1), itertools.count(1)

    def find(self, stage: AnyStage, run_id: str) -> StageResult | None:
        result = self._results.get(stage.digest)
        if result is not None:
            self._events[run_id][stage.digest] = None
        elif stage.role == "robot":
            self._publish(stage, run_id)
        return result

    def begin(self, beginnings: Sequence[Beginning]) -> list[str | None]:
        return [self._begin(each.stage, each.run_id) for each in beginnings]

    def _begin(self, stage: AnyStage, run_id: str) -> str | None:
        if stage.role != "target":
            return None
        visit = self._publish(stage, run_id)
        visit.state, visit.lease = "claimed", f"lease_{next(self._leases)}"
        return visit.lease

    def drop(self, stage: AnyStage) -> None:
        visit = self._visits.get(stage.digest)
        if visit is not None and not visit.is_external and visit.state == "claimed":
            del self._visits[stage.digest]

    def commit(self, outcomes: Sequence[Outcome]) -> list[StageResult]:
        for outcome in outcomes:
            digest = outcome.stage.digest
            if outcome.lease is not None:
                self._finish(digest, outcome.lease)
            self._results.setdefault(digest, outcome.result)
            self._executions.setdefault(digest, outcome.execution)
            for run_id in outcome.run_ids:
                self._events[run_id][digest] = None
        return [self._results[outcome.stage.digest] for outcome in outcomes]

    def note(self, stage: AnyStage, checkpoint: Checkpoint, run_ids: Sequence[str]) -> None:
        """Checkpoints are for people; no result needs them."""

    def submit(self) -> str:
        run_id = f"run_{next(self._runs)}"
        self._live.add(run_id)
        self._events[run_id] = {}
        return run_id

    def begin_run(self, run_id: str, submission: int) -> None: ...

    def end_run(self, run_id: str, submission: int, state: RunState) -> None:
        self._live.discard(run_id)
        for visit in self._visits.values():
            if visit.run_id == run_id and visit.is_external and visit.state in _OPEN:
                visit.state, visit.lease = "withdrawn", None

    def resubmit(self, run_id: str) -> None:
        self._live.add(run_id)

    def forget_unclaimed(self) -> None:
        for digest in self.claimed():
            del self._visits[digest]
        for visit in self._visits.values():
            if visit.is_external and visit.state == "pending":
                visit.state = "withdrawn"

    def claim(self, robot: str, now: float, lease_s: float) -> Claim | None:
        for digest, visit in self._visits.items():
            is_free = visit.state == "pending" or (
                visit.state == "claimed" and visit.expires <= now
            )
            if visit.is_external and is_free and visit.run_id in self._live:
                visit.state, visit.expires = "claimed", now + lease_s
                visit.lease = lease = f"lease_{next(self._leases)}"
                return Claim(digest, digest, lease)
        return None

    def complete(self, claim: Claim, stage: AnyStage, result: StageResult, now: float) -> None:
        visit = self._visits[claim.digest]
        self._finish(claim.digest, claim.lease)
        self._results.setdefault(claim.digest, result)
        self._events[visit.run_id][claim.digest] = None

    def refuse(self, claim: Claim) -> None:
        visit = self._visits[claim.digest]
        if (visit.state, visit.lease) != ("failed", claim.lease):
            self._check(claim.digest, claim.lease)
            visit.state = "failed"

    def executions(self) -> list[Execution]:
        return list(self._executions.values())

    def stored(self, digests: Sequence[str]) -> set[str]:
        return self._results.keys() & set(digests)

    def finished(self, run_id: str) -> list[str]:
        return list(self._events[run_id])

    def claimed(self) -> list[str]:
        return [d for d, v in self._visits.items() if not v.is_external and v.state in _OPEN]

    def _publish(self, stage: AnyStage, run_id: str) -> _Visit:
        is_external = stage.role == "robot"
        visit = self._visits.get(stage.digest)
        if visit is None:
            visit = self._visits[stage.digest] = _Visit(run_id, is_external, "pending")
        elif visit.state not in _OPEN:
            visit.state, visit.lease = "pending", None
        return visit

    def _finish(self, digest: str, lease: str) -> None:
        visit = self._visits.get(digest)
        if visit is None or (visit.state, visit.lease) != ("done", lease):
            self._check(digest, lease)
            self._visits[digest].state = "done"

    def _check(self, digest: str, lease: str) -> None:
        visit = self._visits.get(digest)
        if visit is None or (visit.state, visit.lease) != ("claimed", lease):
            raise LeaseLost("as the schedule has it")


class DatabaseLedger(DatabaseResults):
    """The service's database, emptied."""

    def __init__(self, database: Database):
        super().__init__(database)
        with database.write("empty") as session:
            for table in reversed(Base.metadata.sorted_tables):
                session.execute(table.delete())

    def submit(self) -> str:
        return run_store.create_run(self._database, SPEC).id

    def begin_run(self, run_id: str, submission: int) -> None:
        event_store.append_event(self._database, run_id, RunStarted(submission=submission))

    def end_run(self, run_id: str, submission: int, state: RunState) -> None:
        event_store.append_event(self._database, run_id, _ending(submission, state))

    def resubmit(self, run_id: str) -> None:
        run_store.resubmit(self._database, run_id)

    def forget_unclaimed(self) -> None:
        visit_store.forget_unclaimed(self._database)

    def claim(self, robot: str, now: float, lease_s: float) -> Claim | None:
        visit = visit_store.claim(self._database, robot, [_TASK], _moment(now), lease_s)
        return None if visit is None else Claim(visit.id, visit.digest, str(visit.lease))

    def complete(self, claim: Claim, stage: AnyStage, result: StageResult, now: float) -> None:
        run_id = visit_store.get_visit(self._database, claim.id).run_id
        finished = StageFinished(kind=stage.kind, digest=claim.digest)
        visit_store.complete(
            self._database,
            claim.id,
            claim.lease,
            result,
            10,
            _moment(now),
            lambda session: event_store.append_to_all(session, [run_id], [finished]),
        )

    def refuse(self, claim: Claim) -> None:
        visit_store.fail(self._database, claim.id, claim.lease, "as the schedule has it")

    def executions(self) -> list[Execution]:
        return stage_store.executions_between(self._database, 0.0, _MOST_S)

    def stored(self, digests: Sequence[str]) -> set[str]:
        return set(stage_store.values_of(self._database, digests))

    def finished(self, run_id: str) -> list[str]:
        records = event_store.events_of(self._database, run_id)
        return [r.event.digest for r in records if isinstance(r.event, StageFinished)]

    def claimed(self) -> list[str]:
        visits = visit_store.list_visits(self._database, external=False)
        return [visit.digest for visit in visits if not visit.state.is_finished]


def _moment(now: float) -> datetime:
    return _EPOCH + timedelta(seconds=now)


def _ending(submission: int, state: RunState) -> RunEvent:
    match state:
        case RunState.SUCCEEDED:
            return RunSucceeded()
        case RunState.FAILED:
            return RunFailed(submission=submission, code="worker_lost", message="see the schedule")
        case _:
            return RunStopped(submission=submission)

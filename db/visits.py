"""Visits to targets: stages that one claimant at a time has under a lease.

    visit = claim(database, "robot-7", ["hopper"], now, lease_s)     # None: nothing to do
    heartbeat(database, visit.id, visit.lease, steps, now, lease_s)
    complete(database, visit.id, visit.lease, result, now, also)     # accepted once, or LeaseLost

The lease's token fences: a claimant that lost a visit to another claim cannot complete it any
more. An expired lease that nobody else has claimed since is still good: a robot's work is dear.
The simulated target claims the visit that it is about to compute, and completes it like a robot.

No other file writes `target_tasks`. Its states, and the functions that lead from one to the next:

    (none) -publish-> pending -claim-> claimed -complete, finish-> done
    claimed -release-> pending, claimed -fail-> failed, claimed -claim, once expired-> claimed
    pending, claimed -withdraw-> withdrawn, and failed, withdrawn, done -publish-> pending
    pending -forget_unclaimed-> withdrawn
"""

import json
import secrets
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import Select, and_, delete, exists, or_, select, update
from sqlalchemy.orm import Session

from adr_service.benchmark.cost import Execution
from adr_service.errors import AdrError, StageFailed, target_failed
from adr_service.events import FINISHED
from adr_service.json_values import canonical_json
from adr_service.stages.base import AnyStage, StageResult
from db.errors import NotFound
from db.models import (
    OPEN_VISIT,
    ArtifactRow,
    RunRow,
    StageRow,
    TargetTaskRow,
    VisitState,
    get_row,
)
from db.session import Database
from db.stages import add_artifact, add_result, find_result

_OPEN_SIMULATED = (~TargetTaskRow.external, TargetTaskRow.state.in_(OPEN_VISIT))
_GOES_ON = (RunRow.cancel_requested.is_(False), RunRow.state.not_in(FINISHED))


class LeaseLost(AdrError):
    """The lease is not good any more: another claimant has the visit, or nobody."""

    code = "lease_lost"


@dataclass(frozen=True, kw_only=True)
class Visit:
    """A visit to a target."""

    number: int  # order of publication
    id: str
    digest: str  # of the stage
    kind: str  # of the stage
    inputs: dict[str, Any]  # of the stage
    run_id: str
    task: str
    external: bool  # for robots; else for the simulated target
    state: VisitState
    attempt: int  # number of claims
    worker: str | None  # the last claimant
    lease: str | None  # token of the last claim; only the claimant may read it
    claimed_at: datetime | None
    expires_at: datetime | None  # None: nobody has it
    steps: int  # of the episode so far
    has_policy: bool  # else random actions
    error: str | None
    created_at: datetime


@dataclass(frozen=True)
class RenewedLease:
    """The new end of a lease, and whether its run still wants the episode."""

    expires_at: datetime
    is_wanted: bool  # else its run was asked to stop, or has ended


def publish(session: Session, stage: AnyStage, run_id: str, now: datetime) -> TargetTaskRow:
    """Offer a stage's visit to claimants, if it is not offered yet; inside a transaction.

    A visit that was withdrawn or has failed is offered again: its run goes on.
    """
    row = session.scalar(select(TargetTaskRow).where(TargetTaskRow.digest == stage.digest))
    if row is None:
        row = _new_row(session, stage, run_id, now)
        session.add(row)
        session.flush()
    elif VisitState(row.state).is_finished:
        row.state, row.lease, row.error, row.steps = VisitState.PENDING, None, None, 0
    return row


def claim(
    database: Database, worker: str, tasks: Sequence[str], now: datetime, lease_s: float
) -> Visit | None:
    """Lease the oldest free visit for robots of these `tasks`; None if there is none.

    A visit is free if nobody has it, or its lease has expired.
    """
    with database.write("claim_task") as session:
        row = session.scalar(_free(tasks, now))
        return None if row is None else _visit(_take(row, worker, now, lease_s))


def is_one_free(database: Database, tasks: Sequence[str], now: datetime) -> bool:
    """True if `claim` would return a visit; takes no lock."""
    with database.read() as session:
        return session.scalar(_free(tasks, now)) is not None


def claim_simulated(
    session: Session, stage: AnyStage, run_id: str, worker: str, now: datetime, lease_s: float
) -> str:
    """Publish and claim a visit for the simulated target; the lease. Inside a transaction.

    An earlier claimant has died: the one service decides which process computes a stage.
    """
    lease = _take(publish(session, stage, run_id, now), worker, now, lease_s).lease
    assert lease is not None
    return lease


def drop_simulated(database: Database, digest: str) -> None:
    """Delete the simulated target's open visit of a stage."""
    with database.write("drop_simulated") as session:
        session.execute(
            delete(TargetTaskRow).where(*_OPEN_SIMULATED, TargetTaskRow.digest == digest)
        )


def forget_unclaimed(database: Database) -> None:
    """Delete the simulated target's open visits, and withdraw those that no robot has claimed.

    For a service that starts: the simulated target died with the one before. A robot's visit is
    offered again as soon as its run asks for it (`publish`). After an upgrade the run may ask for
    another, and robots shall begin with what is wanted. What a robot has claimed stays: its work is
    dear.
    """
    theirs = (TargetTaskRow.external, TargetTaskRow.state == VisitState.PENDING)
    withdrawn = update(TargetTaskRow).where(*theirs).values(state=VisitState.WITHDRAWN)
    with database.write("forget_unclaimed") as session:
        session.execute(delete(TargetTaskRow).where(*_OPEN_SIMULATED))
        session.execute(withdrawn)


def heartbeat(
    database: Database, id: str, lease: str, steps: int, now: datetime, lease_s: float
) -> RenewedLease:
    """Note the steps of an episode that goes on; its lease lasts until `lease_s` after `now`.

    Raises NotFound and LeaseLost.
    """
    with database.write("heartbeat") as session:
        row = _held(session, id, lease)
        row.steps = steps
        until = now + timedelta(seconds=lease_s)
        # one that waited for the database may come after a later one
        row.expires_at = latest = max(until, row.expires_at or until)
        return RenewedLease(latest, is_wanted(session, row.run_id))


def complete(
    database: Database,
    id: str,
    lease: str,
    result: StageResult,
    steps: int,
    now: datetime,
    also: Callable[[Session], None],
) -> Visit:
    """Store the result of an episode of `steps`, and what `also` writes.

    The same again changes nothing. Raises NotFound and LeaseLost.
    """
    with database.write("complete_task") as session:
        row = get_row(session, TargetTaskRow, id)
        is_known = row.state == VisitState.DONE and row.lease == lease
        if is_known and find_result(session, row.digest) == result:
            return _visit(row)
        row = _held(session, id, lease)
        add_result(session, row.digest, row.document, result, _episode(row, now))
        finish(session, row.digest, lease)
        row.steps = steps
        also(session)
        return _visit(row)


def finish(session: Session, digest: str, lease: str) -> None:
    """Close a visit whose result is stored in this transaction.

    The same again, after a commit whose answer was lost, changes nothing. Raises LeaseLost if
    the visit has another lease.
    """
    row = session.scalar(select(TargetTaskRow).where(TargetTaskRow.digest == digest))
    if row is None:
        raise LeaseLost(f"the task of stage {digest} is not there any more")
    if row.state == VisitState.DONE and row.lease == lease:
        return
    _check_lease(row, lease)
    row.state, row.expires_at = VisitState.DONE, None


def release(database: Database, id: str, lease: str) -> Visit:
    """Give a visit back, for others to claim. Raises NotFound and LeaseLost."""
    with database.write("release_task") as session:
        row = _held(session, id, lease)
        row.state, row.expires_at, row.lease, row.steps = VisitState.PENDING, None, None, 0
        return _visit(row)


def fail(
    database: Database,
    id: str,
    lease: str,
    message: str,
    also: Callable[[Session, str, StageFailed], None] = lambda session, run_id, error: None,
) -> Visit:
    """Note that no robot can do this visit.

    `also(session, run_id, error)` writes in the same transaction. The same again changes nothing.
    Raises NotFound and LeaseLost.
    """
    with database.write("fail_task") as session:
        row = get_row(session, TargetTaskRow, id)
        if row.state == VisitState.FAILED and row.lease == lease:
            return _visit(row)
        row = _held(session, id, lease)
        row.state, row.expires_at, row.error = VisitState.FAILED, None, message
        kind: str = json.loads(row.document)["kind"]
        also(session, row.run_id, target_failed(kind, message))
        return _visit(row)


def is_wanted(session: Session, run_id: str) -> bool:
    """True if the run is there, and has neither ended nor been asked to stop."""
    return bool(session.scalar(select(exists().where(RunRow.id == run_id, *_GOES_ON))))


def withdraw(session: Session, run_id: str) -> None:
    """Withdraw the open visits of a run that has ended; inside a transaction."""
    mine = (TargetTaskRow.run_id == run_id, TargetTaskRow.external)
    session.execute(
        update(TargetTaskRow)
        .where(*mine, TargetTaskRow.state.in_(OPEN_VISIT))
        .values(state=VisitState.WITHDRAWN, expires_at=None, lease=None)
    )


def delete_abandoned(session: Session) -> None:
    """Delete closed visits whose stage has no result; inside a transaction.

    A robot's stay as long as their run, which may be resumed, and say why they failed.
    """
    has_result = exists().where(StageRow.digest == TargetTaskRow.digest)
    is_open = TargetTaskRow.state.in_(OPEN_VISIT)
    is_theirs = TargetTaskRow.external & exists().where(RunRow.id == TargetTaskRow.run_id)
    session.execute(delete(TargetTaskRow).where(~has_result, ~is_open, ~is_theirs))


def claimed_by(database: Database, id: str, lease: str) -> Visit:
    """The visit of a lease that is good, or that has completed it; LeaseLost for any other."""
    with database.read() as session:
        row = get_row(session, TargetTaskRow, id)
        if row.state != VisitState.DONE or row.lease != lease:
            _check_lease(row, lease)
        return _visit(row)


def renew_leases(database: Database, now: datetime, lease_s: float) -> None:
    """Let all robots' leases expire `lease_s` after `now`, when a service starts.

    Nobody could prolong them while there was none, and the clock may have been set meanwhile.
    """
    claimed = (TargetTaskRow.external, TargetTaskRow.state == VisitState.CLAIMED)
    with database.write("renew_leases") as session:
        until = now + timedelta(seconds=lease_s)
        session.execute(update(TargetTaskRow).where(*claimed).values(expires_at=until))


def get_visit(database: Database, id: str) -> Visit:
    """The visit with this id. Raises NotFound."""
    with database.read() as session:
        return _visit(get_row(session, TargetTaskRow, id))


def list_visits(
    database: Database,
    *,
    states: Collection[str] | None = None,
    run_id: str | None = None,
    external: bool | None = None,
    after: int = 0,
    limit: int = 100,
    newest_first: bool = False,
) -> list[Visit]:
    """Visits in one of the states (None: in any), in order of publication, or the newest first;
    those numbered above `after`."""
    order = TargetTaskRow.number.desc() if newest_first else TargetTaskRow.number
    query = select(TargetTaskRow).where(TargetTaskRow.number > after)
    if states is not None:
        query = query.where(TargetTaskRow.state.in_(states))
    filters = ((TargetTaskRow.run_id, run_id), (TargetTaskRow.external, external))
    query = query.where(*(column == value for column, value in filters if value is not None))
    with database.read() as session:
        rows = session.scalars(query.order_by(order).limit(limit))
        return [_visit(row) for row in rows]


def policy_of(database: Database, id: str) -> bytes:
    """The policy that acts in an episode. Raises NotFound if there is none."""
    with database.read() as session:
        row = get_row(session, TargetTaskRow, id)
        if row.policy_sha256 is None:
            raise NotFound("policy of target task", id)
        return session.get_one(ArtifactRow, row.policy_sha256).content


def _new_row(session: Session, stage: AnyStage, run_id: str, now: datetime) -> TargetTaskRow:
    external = stage.role == "robot"
    policy = stage.blobs.get("policy") if external else None
    return TargetTaskRow(
        id=f"task_{secrets.token_hex(8)}",
        digest=stage.digest,
        document=canonical_json(stage.document),
        run_id=run_id,
        task=stage.task,
        external=external,
        state=VisitState.PENDING,
        attempt=0,
        steps=0,
        policy_sha256=None if policy is None else add_artifact(session, policy),
        created_at=now,
    )


def _free(tasks: Sequence[str], now: datetime) -> Select[TargetTaskRow]:
    expired = and_(TargetTaskRow.state == VisitState.CLAIMED, TargetTaskRow.expires_at <= now)
    wanted = exists().where(RunRow.id == TargetTaskRow.run_id, *_GOES_ON)
    return (
        select(TargetTaskRow)
        .where(TargetTaskRow.external, TargetTaskRow.task.in_(tasks), wanted)
        .where(or_(TargetTaskRow.state == VisitState.PENDING, expired))
        .order_by(TargetTaskRow.number)
        .limit(1)
    )


def _take(row: TargetTaskRow, worker: str, now: datetime, lease_s: float) -> TargetTaskRow:
    row.state, row.worker, row.lease = VisitState.CLAIMED, worker, secrets.token_hex(16)
    row.attempt, row.steps, row.claimed_at = row.attempt + 1, 0, now
    row.expires_at = now + timedelta(seconds=lease_s)
    return row


def _episode(row: TargetTaskRow, now: datetime) -> Execution:
    """The execution of an episode that ends now: from its claim, on no core."""
    assert row.claimed_at is not None
    claimed = row.claimed_at.timestamp()
    return Execution(
        attempt=row.attempt,
        started_by=row.run_id,
        asked=row.created_at.timestamp(),
        placed=claimed,
        began=claimed,
        ended=now.timestamp(),
        provenance={"worker": row.worker},
    )


def _held(session: Session, id: str, lease: str) -> TargetTaskRow:
    row = get_row(session, TargetTaskRow, id)
    _check_lease(row, lease)
    return row


def _check_lease(row: TargetTaskRow, lease: str) -> None:
    held = row.state == VisitState.CLAIMED and row.lease is not None
    if not held or not secrets.compare_digest(str(row.lease).encode(), lease.encode()):
        claims = "1 claim" if row.attempt == 1 else f"{row.attempt} claims"
        raise LeaseLost(
            f"the lease of {row.id} is no longer valid: the task is {row.state}, after {claims}; "
            "stop, and claim again"
        )


def _visit(row: TargetTaskRow) -> Visit:
    document = json.loads(row.document)
    return Visit(
        number=row.number,
        id=row.id,
        digest=row.digest,
        kind=document["kind"],
        inputs=document["inputs"],
        run_id=row.run_id,
        task=row.task,
        external=row.external,
        state=VisitState(row.state),
        attempt=row.attempt,
        worker=row.worker,
        lease=row.lease,
        claimed_at=row.claimed_at,
        expires_at=row.expires_at,
        steps=row.steps,
        has_policy=row.policy_sha256 is not None,
        error=row.error,
        created_at=row.created_at,
    )

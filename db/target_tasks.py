"""Visits to targets, each a task that one claimant at a time has under a lease.

    task = claim(database, "robot-7", ["hopper"], now, lease_s)    # None: nothing to do
    heartbeat(database, task.id, task.lease, steps, now, lease_s)
    complete(database, task.id, task.lease, result, now)           # accepted once, or LeaseLost

The lease's token fences: whoever lost a task to another claim cannot complete it any more. An
expired lease that nobody else has claimed since is as good as a live one: a robot's work is dear.
The simulated target claims the task that it is about to compute, and completes it like a robot.
"""

import json
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import and_, delete, exists, or_, select, update
from sqlalchemy.orm import Session

from adr_service.errors import AdrError
from adr_service.events import FINISHED
from adr_service.json_values import canonical_json, sha256
from adr_service.stages import KINDS, Stage, StageResult
from db.errors import NotFound
from db.models import ArtifactRow, RunRow, StageArtifactRow, TargetTaskRow
from db.session import Database
from db.stages import Execution, add_artifact, add_result

_OPEN = ("pending", "claimed")


class LeaseLost(AdrError):
    """The task is somebody else's by now, or nobody's."""

    code = "lease_lost"


@dataclass(frozen=True)
class TargetTask:
    number: int
    id: str
    digest: str
    kind: str  # of the stage
    inputs: dict[str, Any]  # of the stage
    run_id: str
    task: str
    external: bool
    state: str
    attempt: int
    worker: str | None
    lease: str | None  # for the claimant's eyes alone
    claimed_at: datetime | None
    expires_at: datetime | None
    steps: int
    has_policy: bool
    error: str | None
    created_at: datetime
    is_unwanted: bool  # its run was asked to stop, or has ended


def publish(session: Session, stage: Stage, run_id: str, now: datetime) -> TargetTaskRow:
    """Offer a stage's visit, if it is not offered yet; inside a transaction.

    What was withdrawn or has failed is offered again: its run goes on.
    """
    row = session.scalar(select(TargetTaskRow).where(TargetTaskRow.digest == stage.digest))
    if row is None:
        external = KINDS[stage.kind].role == "robot"
        policy = stage.blobs.get("policy") if external else None
        row = TargetTaskRow(
            id=f"task_{secrets.token_hex(8)}",
            digest=stage.digest,
            document=canonical_json(stage.document),
            run_id=run_id,
            task=stage.inputs["task"],
            external=external,
            state="pending",
            attempt=0,
            steps=0,
            policy_sha256=None if policy is None else add_artifact(session, policy),
            created_at=now,
        )
        session.add(row)
        session.flush()
    elif row.state not in _OPEN:
        row.state, row.lease, row.error = "pending", None, None
    return row


def claim(
    database: Database, worker: str, tasks: Sequence[str], now: datetime, lease_s: float
) -> TargetTask | None:
    """The oldest task for robots of these `tasks` that nobody has, or whose lease expired."""
    with database.write("claim_task") as session:
        row = session.scalar(_free(tasks, now))
        return None if row is None else _record(session, _take(row, worker, now, lease_s))


def is_one_free(database: Database, tasks: Sequence[str], now: datetime) -> bool:
    """Whether `claim` would find something; takes no lock."""
    with database.read() as session:
        return session.scalar(_free(tasks, now)) is not None


def claim_simulated(
    session: Session, stage: Stage, run_id: str, worker: str, now: datetime, lease_s: float
) -> str:
    """The lease of a task that the simulated target is about to compute; inside a transaction.

    Whoever had it before has died: there is one service, which decides who computes what.
    """
    lease = _take(publish(session, stage, run_id, now), worker, now, lease_s).lease
    assert lease is not None
    return lease


def drop_simulated(database: Database, digest: str | None = None) -> None:
    """Forget a claim of the simulated target that led to no result; without a digest, all."""
    claimed = [~TargetTaskRow.external, TargetTaskRow.state.in_(_OPEN)]
    if digest is not None:
        claimed.append(TargetTaskRow.digest == digest)
    with database.write("drop_simulated") as session:
        session.execute(delete(TargetTaskRow).where(*claimed))


def heartbeat(
    database: Database, id: str, lease: str, steps: int, now: datetime, lease_s: float
) -> TargetTask:
    """Say that an episode goes on, `steps` far; the lease is good for `lease_s` from now."""
    with database.write("heartbeat") as session:
        row = _held(session, id, lease)
        row.steps, row.expires_at = steps, now + timedelta(seconds=lease_s)
        return _record(session, row)


def complete(
    database: Database,
    id: str,
    lease: str,
    result: StageResult,
    now: datetime,
    also: Callable[[Session], None],
) -> TargetTask:
    """Store what an episode showed, and what `also` writes. The same again changes nothing."""
    with database.write("complete_task") as session:
        row = _task(session, id)
        if row.state == "done" and row.lease == lease and _is_stored(session, row.digest, result):
            return _record(session, row)
        row = _held(session, id, lease)
        assert row.claimed_at is not None
        seconds, provenance = (now - row.claimed_at).total_seconds(), {"worker": row.worker}
        execution = Execution(row.attempt, row.run_id, seconds, None, provenance)
        add_result(session, row.digest, row.document, result, execution)
        finish(session, row.digest, lease)
        row.steps = result.values["transitions"]
        also(session)
        return _record(session, row)


def finish(session: Session, digest: str, lease: str) -> None:
    """Close a task whose result is stored in this transaction; LeaseLost where it has another.

    The same again, after a commit whose answer was lost, changes nothing.
    """
    row = session.scalar(select(TargetTaskRow).where(TargetTaskRow.digest == digest))
    if row is None:
        raise LeaseLost(f"the task of stage {digest} is not there any more")
    if row.state == "done" and row.lease == lease:
        return
    _check_lease(row, lease)
    row.state, row.expires_at = "done", None


def release(database: Database, id: str, lease: str) -> TargetTask:
    """Give a task back, for others to claim."""
    with database.write("release_task") as session:
        row = _held(session, id, lease)
        row.state, row.expires_at, row.lease = "pending", None, None
        return _record(session, row)


def fail(database: Database, id: str, lease: str, message: str) -> TargetTask:
    """Say that nobody can do this task; its run fails with the message. Again changes nothing."""
    with database.write("fail_task") as session:
        row = _task(session, id)
        if row.state == "failed" and row.lease == lease:
            return _record(session, row)
        row = _held(session, id, lease)
        row.state, row.expires_at, row.error = "failed", None, message
        return _record(session, row)


def withdraw_tasks(session: Session, run_id: str) -> None:
    """A run has ended: nobody needs to visit its target any more; inside a transaction."""
    mine = (TargetTaskRow.run_id == run_id, TargetTaskRow.external)
    session.execute(
        update(TargetTaskRow)
        .where(*mine, TargetTaskRow.state.in_(_OPEN))
        .values(state="withdrawn", expires_at=None, lease=None)
    )


def claimed_by(database: Database, id: str, lease: str) -> TargetTask:
    """The task of a lease that is good, or that has completed it; LeaseLost for any other."""
    with database.read() as session:
        row = _task(session, id)
        if row.state != "done" or row.lease != lease:
            _check_lease(row, lease)
        return _record(session, row)


def renew_leases(database: Database, now: datetime, lease_s: float) -> None:
    """Let all robots' leases be good for `lease_s` from now: a service starts.

    Nobody could prolong them while there was none, and the clock may have been set meanwhile.
    """
    claimed = (TargetTaskRow.external, TargetTaskRow.state == "claimed")
    with database.write("renew_leases") as session:
        until = now + timedelta(seconds=lease_s)
        session.execute(update(TargetTaskRow).where(*claimed).values(expires_at=until))


def get_task(database: Database, id: str) -> TargetTask:
    with database.read() as session:
        return _record(session, _task(session, id))


def list_tasks(
    database: Database,
    *,
    state: str | None = None,
    run_id: str | None = None,
    external: bool | None = None,
    after: int = 0,
    limit: int = 100,
) -> list[TargetTask]:
    """Tasks in order of publication, those numbered above `after`."""
    query = select(TargetTaskRow).where(TargetTaskRow.number > after)
    given = (
        (TargetTaskRow.state, state),
        (TargetTaskRow.run_id, run_id),
        (TargetTaskRow.external, external),
    )
    query = query.where(*(column == value for column, value in given if value is not None))
    with database.read() as session:
        rows = session.scalars(query.order_by(TargetTaskRow.number).limit(limit))
        return [_record(session, row) for row in rows]


def policy_of(database: Database, id: str) -> bytes:
    """The policy whose actions a task asks for."""
    with database.read() as session:
        row = _task(session, id)
        if row.policy_sha256 is None:
            raise NotFound("policy of target task", id)
        return session.get_one(ArtifactRow, row.policy_sha256).content


def _free(tasks: Sequence[str], now: datetime) -> Any:
    expired = and_(TargetTaskRow.state == "claimed", TargetTaskRow.expires_at <= now)
    wanted = exists().where(
        RunRow.id == TargetTaskRow.run_id,
        RunRow.cancel_requested.is_(False),
        RunRow.state.not_in(FINISHED),
    )
    return (
        select(TargetTaskRow)
        .where(TargetTaskRow.external, TargetTaskRow.task.in_(tasks), wanted)
        .where(or_(TargetTaskRow.state == "pending", expired))
        .order_by(TargetTaskRow.number)
        .limit(1)
    )


def _take(row: TargetTaskRow, worker: str, now: datetime, lease_s: float) -> TargetTaskRow:
    row.state, row.worker, row.lease = "claimed", worker, secrets.token_hex(16)
    row.attempt, row.steps, row.claimed_at = row.attempt + 1, 0, now
    row.expires_at = now + timedelta(seconds=lease_s)
    return row


def _task(session: Session, id: str) -> TargetTaskRow:
    row = session.scalar(select(TargetTaskRow).where(TargetTaskRow.id == id))
    if row is None:
        raise NotFound("target task", id)
    return row


def _held(session: Session, id: str, lease: str) -> TargetTaskRow:
    row = _task(session, id)
    _check_lease(row, lease)
    return row


def _check_lease(row: TargetTaskRow, lease: str) -> None:
    held = row.state == "claimed" and row.lease is not None
    if not held or not secrets.compare_digest(str(row.lease).encode(), lease.encode()):
        raise LeaseLost(
            f"the lease of {row.id} is not good any more: the task is {row.state}, "
            f"and was claimed {row.attempt} times; stop, and claim again"
        )


def _is_stored(session: Session, digest: str, result: StageResult) -> bool:
    stored = session.execute(
        select(StageArtifactRow.name, StageArtifactRow.sha256).where(
            StageArtifactRow.digest == digest
        )
    )
    given = {name: sha256(content) for name, content in result.blobs.items()}
    return {row.name: row.sha256 for row in stored} == given


def _record(session: Session, row: TargetTaskRow) -> TargetTask:
    run = session.scalar(select(RunRow).where(RunRow.id == row.run_id))
    document = json.loads(row.document)
    return TargetTask(
        row.number,
        row.id,
        row.digest,
        document["kind"],
        document["inputs"],
        row.run_id,
        row.task,
        row.external,
        row.state,
        row.attempt,
        row.worker,
        row.lease,
        row.claimed_at,
        row.expires_at,
        row.steps,
        row.policy_sha256 is not None,
        row.error,
        row.created_at,
        run is None or run.cancel_requested or run.state in FINISHED,
    )

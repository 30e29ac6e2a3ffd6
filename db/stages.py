"""Results of stages and their artifacts; one function per transaction."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import delete, exists, select
from sqlalchemy.orm import Session

from adr_service.benchmark.utilisation import Timing
from adr_service.json_values import canonical_json, sha256
from adr_service.stages import StageResult
from db.models import (
    ArtifactRow,
    CheckpointRow,
    DatasetRow,
    EventRow,
    StageArtifactRow,
    StageRow,
    TargetTaskRow,
)
from db.session import CHUNK, Database

_OWNERS = (
    *(StageArtifactRow.sha256, DatasetRow.sha256, CheckpointRow.sha256),
    TargetTaskRow.policy_sha256,
)
_UNUSED = [~exists().where(owner == ArtifactRow.sha256) for owner in _OWNERS]  # that nothing has


@dataclass(frozen=True)
class Execution:
    """How a result came about; kept beside it, not part of it."""

    attempt: int
    started_by: str  # run id
    seconds: float
    timing: Timing | None  # None: it was not computed here
    provenance: dict[str, Any]  # package versions, CPU


def find_result(session: Session, digest: str) -> StageResult | None:
    """The stored result of a stage, whole; inside a transaction."""
    row = session.get(StageRow, digest)
    if row is None:
        return None
    blobs = session.execute(
        select(StageArtifactRow.name, ArtifactRow.content)
        .join(ArtifactRow, ArtifactRow.sha256 == StageArtifactRow.sha256)
        .where(StageArtifactRow.digest == digest)
    )
    return StageResult(json.loads(row.result), {row.name: row.content for row in blobs})


def add_result(
    session: Session, digest: str, document: str, result: StageResult, execution: Execution
) -> None:
    """Store a stage's result and its artifacts, once; inside a transaction.

    `document` is the canonical JSON of what was digested. A result that is there already stays;
    results of a digest are equal by construction.
    """
    if session.get(StageRow, digest) is None:
        timing = execution.timing
        session.add(
            StageRow(
                digest=digest,
                kind=json.loads(document)["kind"],
                document=document,
                result=canonical_json(result.values),
                attempt=execution.attempt,
                started_by=execution.started_by,
                seconds=execution.seconds,
                timing=None if timing is None else canonical_json(asdict(timing)),
                provenance=canonical_json(execution.provenance),
                created_at=datetime.now(UTC),
            )
        )
        session.flush()
        for name, content in result.blobs.items():
            key = add_artifact(session, content)
            session.add(StageArtifactRow(digest=digest, name=name, sha256=key))
        session.flush()
    _drop_checkpoint(session, digest)


def note_checkpoint(session: Session, digest: str, steps: int, policy: bytes) -> None:
    """Keep the best policy so far of a training, in the place of the one before.

    A training that was lost and starts again knows less for a while than what is kept.
    """
    row = session.get(CheckpointRow, digest)
    if session.get(StageRow, digest) is not None or (row is not None and row.steps >= steps):
        return
    _drop_checkpoint(session, digest)
    key = add_artifact(session, policy)
    session.add(CheckpointRow(digest=digest, steps=steps, sha256=key))
    session.flush()


def timings_between(database: Database, first: float, last: float) -> list[Timing]:
    """Of all stages that were computed at some time between `first` and `last`, for any run.

    A result is stored soon after it was computed, and an hour is soon.
    """
    late, early = (datetime.fromtimestamp(at, UTC) for at in (last + 3600, first))
    with database.read() as session:
        rows = session.scalars(
            select(StageRow.timing)
            .where(StageRow.timing.is_not(None))
            .where(StageRow.created_at >= early, StageRow.created_at <= late)
        )
        found = [Timing(**json.loads(row)) for row in rows if row is not None]
    return [timing for timing in found if timing.placed < last and timing.ended > first]


def timings_of(database: Database, run_ids: Sequence[str]) -> list[tuple[str, Timing]]:
    """(kind, timing) of the stages that the runs have results of, in order of their beginning."""
    found: dict[str, tuple[str, Timing]] = {}
    with database.read() as session:
        for first in range(0, len(run_ids), CHUNK):
            rows = session.execute(
                select(StageRow.digest, StageRow.kind, StageRow.timing)
                .join(EventRow, EventRow.key == "stage_finished:" + StageRow.digest)
                .where(EventRow.run_id.in_(run_ids[first : first + CHUNK]))
                .where(StageRow.timing.is_not(None))
            )
            found |= {row.digest: (row.kind, Timing(**json.loads(row.timing))) for row in rows}
    return sorted(found.values(), key=lambda item: item[1].began)


def policy_of_training(database: Database, digest: str) -> bytes | None:
    """The policy of a training: the best so far, where it has not finished."""
    with database.read() as session:
        result = find_result(session, digest)
        if result is not None:
            return result.blobs.get("policy")
        checkpoint = session.get(CheckpointRow, digest)
        row = session.get(ArtifactRow, checkpoint.sha256) if checkpoint else None
        return row.content if row else None


def _drop_checkpoint(session: Session, digest: str) -> None:
    row = session.get(CheckpointRow, digest)
    if row is not None:
        session.delete(row)
        session.flush()
        session.execute(delete(ArtifactRow).where(ArtifactRow.sha256 == row.sha256, *_UNUSED))


def artifact(database: Database, digest: str) -> bytes | None:
    """The bytes with this SHA-256."""
    with database.read() as session:
        row = session.get(ArtifactRow, digest)
        return None if row is None else row.content


def delete_unreferenced(session: Session) -> None:
    """Delete stages that no run's events mention, what is left of target tasks without a stage,
    then artifacts that nothing has."""
    mentioned = exists().where(EventRow.key == "stage_finished:" + StageRow.digest)
    session.execute(delete(StageRow).where(~mentioned))
    evaluated = exists().where(
        EventRow.key.startswith("training_evaluated:" + CheckpointRow.digest + ":")
    )
    session.execute(delete(CheckpointRow).where(~evaluated))
    has_result = exists().where(StageRow.digest == TargetTaskRow.digest)
    is_wanted = TargetTaskRow.state.in_(("pending", "claimed"))
    session.execute(delete(TargetTaskRow).where(~has_result, ~is_wanted))
    session.execute(delete(ArtifactRow).where(*_UNUSED))


def add_artifact(session: Session, content: bytes) -> str:
    """Store bytes, once; their SHA-256."""
    key = sha256(content)
    if session.get(ArtifactRow, key) is None:
        session.add(ArtifactRow(sha256=key, size=len(content), content=content))
        session.flush()
    return key


def seconds_of(database: Database, digests: Sequence[str]) -> dict[str, float]:
    """How long stages took to compute, of those that have a result."""
    found: dict[str, float] = {}
    with database.read() as session:
        for first in range(0, len(digests), CHUNK):
            chunk = StageRow.digest.in_(digests[first : first + CHUNK])
            rows = session.execute(select(StageRow.digest, StageRow.seconds).where(chunk))
            found |= {row.digest: row.seconds for row in rows}
    return found

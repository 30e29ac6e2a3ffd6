"""Results of stages and their artifacts; one function per transaction."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import delete, exists, select
from sqlalchemy.orm import Session

from adr_service.stages import Stage, StageResult
from adr_service.wire import canonical_json, sha256
from db.models import ArtifactRow, EventRow, StageArtifactRow, StageRow
from db.session import Database


@dataclass(frozen=True)
class Execution:
    """How a result came about; kept beside it, not part of it."""

    attempt: int
    started_by: str  # run id
    seconds: float
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


def commit_result(
    database: Database,
    stage: Stage,
    result: StageResult,
    execution: Execution,
    also: Callable[[Session], None],
) -> None:
    """Store a result, its artifacts and what `also` writes, in one transaction, once.

    A result that is there already stays; results of a digest are equal by construction.
    """
    with database.write() as session:
        if session.get(StageRow, stage.digest) is None:
            session.add(
                StageRow(
                    digest=stage.digest,
                    kind=stage.kind,
                    document=canonical_json(stage.document),
                    result=canonical_json(result.values),
                    attempt=execution.attempt,
                    started_by=execution.started_by,
                    seconds=execution.seconds,
                    provenance=canonical_json(execution.provenance),
                    created_at=datetime.now(UTC),
                )
            )
            session.flush()
            for name, content in result.blobs.items():
                _add_artifact(session, stage.digest, name, content)
        also(session)


def artifact(database: Database, digest: str) -> bytes | None:
    """The bytes with this SHA-256."""
    with database.read() as session:
        row = session.get(ArtifactRow, digest)
        return None if row is None else row.content


def delete_unreferenced(session: Session) -> None:
    """Delete stages that no run's events mention, then artifacts that no stage has."""
    mentioned = exists().where(EventRow.key == "stage_finished:" + StageRow.digest)
    session.execute(delete(StageRow).where(~mentioned))
    used = exists().where(StageArtifactRow.sha256 == ArtifactRow.sha256)
    session.execute(delete(ArtifactRow).where(~used))


def _add_artifact(session: Session, digest: str, name: str, content: bytes) -> None:
    key = sha256(content)
    if session.get(ArtifactRow, key) is None:
        session.add(ArtifactRow(sha256=key, size=len(content), content=content))
        session.flush()
    session.add(StageArtifactRow(digest=digest, name=name, sha256=key))

"""Results of stages, their artifacts and checkpoints, and how each result came about."""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from pydantic import FiniteFloat, TypeAdapter, ValidationError
from sqlalchemy import ColumnElement, Row, Select, String, cast, delete, exists, func, select
from sqlalchemy.orm import Session

from adr_service.benchmark.cost import Execution
from adr_service.errors import InvalidInput
from adr_service.events import StageFinished, TrainingEvaluated, type_of
from adr_service.json_values import Line, canonical_json, sha256
from adr_service.plugins import other_versions
from adr_service.stages.base import StageResult
from adr_service.stages.catalogue import VERSIONS
from db.models import (
    ArtifactRow,
    CheckpointRow,
    DatasetRow,
    EventRow,
    ImportedStageRow,
    StageArtifactRow,
    StageRow,
    TargetTaskRow,
    copy_of,
)
from db.session import CHUNK, Database, parts

_OWNERS = (
    *(StageArtifactRow.sha256, DatasetRow.sha256, CheckpointRow.sha256),
    TargetTaskRow.policy_sha256,
)
_UNUSED = [~exists().where(owner == ArtifactRow.sha256) for owner in _OWNERS]
# the first four are always known
_TIMING = ("asked", "placed", "began", "ended", "cpu", "preparing", "is_first", "cores")
_FINISHED = type_of(StageFinished)
_MENTIONED = EventRow.key == f"{_FINISHED}:" + StageRow.digest  # looks events up, for a stage
# looks stages up, for events
_OF_EVENT = (EventRow.type == _FINISHED) & (
    StageRow.digest == func.substr(EventRow.key, len(_FINISHED) + 2)
)
_PROVENANCE = TypeAdapter(dict[Line, Line])
_NUMBERS = TypeAdapter(dict[str, bool | int | FiniteFloat | None])
_UNMENTIONED = ~exists().where(_MENTIONED)
_IMPORTED = exists().where(ImportedStageRow.digest == StageRow.digest)
_MEASURED = StageRow.timing.is_not(None)
HAS_PACKAGE = StageRow.document.contains('package":"')
_PACKAGE = re.compile(r'package":"([\w.-]{1,100}) ([\w.+!-]{1,50})"')
_VERSION = re.compile(r'"version":(\d+)}$')  # at the end of a document, which is sorted
_LONGEST_VERSION = 20
_LATEST = 4e9  # seconds since 1970: the year 2096
_STORED_LATE_S = 3600.0  # a result is stored at most so long after it was computed

_ExecutionRow = Row[str, str, int, str, str | None, str]


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
) -> StageResult:
    """Store a stage's result and its artifacts, once; the stored result. Inside a transaction.

    `document` is the canonical JSON that `digest` is of. A result that is there already stays: an
    archive may have brought it meanwhile, computed by another type of CPU.
    """
    stored = find_result(session, digest)
    if stored is None:
        session.add(_row(digest, document, result, execution))
        session.flush()
        for name, content in result.blobs.items():
            key = add_artifact(session, content)
            session.add(StageArtifactRow(digest=digest, name=name, sha256=key))
        session.flush()
    _drop_checkpoint(session, digest)
    return result if stored is None else stored


def note_checkpoint(session: Session, digest: str, steps: int, policy: bytes) -> None:
    """Store the best policy so far of a training, in place of the one before.

    Inside a transaction. A training that was lost and starts again is for a while behind the
    checkpoint, which then stays.
    """
    row = session.get(CheckpointRow, digest)
    if session.get(StageRow, digest) is not None or (row is not None and row.steps >= steps):
        return
    _drop_checkpoint(session, digest)
    key = add_artifact(session, policy)
    session.add(CheckpointRow(digest=digest, steps=steps, sha256=key))
    session.flush()


def executions_between(database: Database, first: float, last: float) -> list[Execution]:
    """Executions measured here, for any run, that overlap the time from `first` to `last`."""
    with database.read() as session:
        longest = session.scalar(select(func.max(StageRow.seconds))) or 0.0
        late = min(last + longest + _STORED_LATE_S, _LATEST)
        early, late = (datetime.fromtimestamp(at, UTC) for at in (first, late))
        query = _executions().where(StageRow.created_at.between(early, late), ~_IMPORTED)
        executions = [_execution(row) for row in session.execute(query)]
    return [e for e in executions if e.placed < last and e.ended > first]


def executions_of(
    database: Database, run_ids: Sequence[str], *, only_here: bool = False
) -> list[tuple[str, Execution]]:
    """Pairs (stage kind, execution) of the runs' measured stages, in order of their beginning.

    `only_here` leaves out those that an archive brought.
    """
    query = _executions().join(EventRow, _OF_EVENT)
    if only_here:
        query = query.where(~_IMPORTED)
    executions: dict[str, tuple[str, Execution]] = {}
    with database.read() as session:
        for some in parts(run_ids, CHUNK):
            rows = session.execute(query.where(EventRow.run_id.in_(some)))
            executions |= {row.digest: (row.kind, _execution(row)) for row in rows}
    return sorted(executions.values(), key=lambda item: item[1].began)


def cpu_seconds_of(database: Database, digests: Sequence[str]) -> dict[str, float]:
    """The CPU seconds that stages took, by digest, of those for which they were measured.

    Without imports and compilations. They depend on the type of CPU.
    """
    seconds: dict[str, float] = {}
    with database.read() as session:
        for some in parts(digests, CHUNK):
            for row in session.execute(_executions().where(StageRow.digest.in_(some))):
                execution = _execution(row)
                if execution.is_measured:
                    seconds[row.digest] = execution.computing
    return seconds


def values_of(database: Database, digests: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Stored results without their binary parts, by digest."""
    query, values = select(StageRow.digest, StageRow.result), dict[str, dict[str, Any]]()
    with database.read() as session:
        for part in parts(digests, CHUNK):
            rows = session.execute(query.where(StageRow.digest.in_(part)))
            values |= {row.digest: json.loads(row.result) for row in rows}
    return values


def checkpoints_of(database: Database, digests: Sequence[str]) -> set[str]:
    """Digests, among these, that have a checkpoint."""
    query, found = select(CheckpointRow.digest), set[str]()
    with database.read() as session:
        for part in parts(digests, CHUNK):
            found.update(session.scalars(query.where(CheckpointRow.digest.in_(part))))
    return found


def packaged_inputs(database: Database, run_ids: Sequence[str]) -> list[tuple[str, dict[str, Any]]]:
    """Pairs (run, inputs as JSON) of the runs' stages whose task or method a package adds."""
    columns = select(EventRow.run_id, StageRow.document).join(StageRow, _OF_EVENT)
    query = columns.where(HAS_PACKAGE)
    found: list[tuple[str, dict[str, Any]]] = []
    with database.read() as session:
        for some in parts(run_ids, CHUNK):
            rows = session.execute(query.where(EventRow.run_id.in_(some)))
            documents = ((row.run_id, json.loads(row.document).get("inputs")) for row in rows)
            found += [(id, inputs) for id, inputs in documents if isinstance(inputs, dict)]
    return found


@dataclass(frozen=True)
class Versions:
    """Names with the versions that stages are of."""

    kinds: set[tuple[str, str]]  # of stages
    packages: set[tuple[str, str]]  # that add their tasks and methods


def versions_of(session: Session, run_ids: Sequence[str]) -> Versions:
    """The versions that the runs' stages are of; inside a transaction.

    Read from the text of their documents, which may be a stranger's that nobody could check.
    """
    end = func.substr(StageRow.document, func.length(StageRow.document) - _LONGEST_VERSION)
    kinds = select(StageRow.kind, end).join(EventRow, _OF_EVENT).distinct()
    packaged = select(StageRow.document).join(EventRow, _OF_EVENT).where(HAS_PACKAGE)
    found = Versions(set(), set())
    for some in parts(run_ids, CHUNK):
        mine = EventRow.run_id.in_(some)
        for kind, text in session.execute(kinds.where(mine)):
            if match := _VERSION.search(text):
                found.kinds.add((kind, match[1]))
        found.packages.update(packages_in(session.scalars(packaged.where(mine))))
    return found


def packages_in(documents: Iterable[str]) -> set[tuple[str, str]]:
    """Names and versions of the packages that documents of stages name."""
    return {package for text in documents for package in _PACKAGE.findall(text)}


def check_versions(database: Database, id: str, run_ids: Sequence[str]) -> None:
    """Raise InvalidInput if a package or a kind of stage has another version now than in the stages
    of these runs, all runs of the run or the benchmark `id`.

    Rows would mix what does not compare, and a run would compute its finished iterations again.
    """
    for _, inputs in packaged_inputs(database, run_ids):
        for other in other_versions(inputs).values():
            raise InvalidInput(
                f"{id} was computed with {other.of_stage}, and {other.here} is installed; submit "
                "it anew"
            )
    with database.read() as session:
        kinds = versions_of(session, run_ids).kinds
    for kind, version in sorted(kinds):
        if version != str(VERSIONS.get(kind, version)):
            raise InvalidInput(
                f"{id} has stages of version {version} of {kind}, and this service computes "
                f"version {VERSIONS[kind]}; submit it anew"
            )


def provenance_of(session: Session, digest: str) -> dict[str, Any]:
    """Versions and CPU type that a stored stage was computed with; inside a transaction."""
    return json.loads(session.get_one(StageRow, digest).provenance)


def is_readable(row: StageRow) -> bool:
    """True if a stage's execution can be read, with a provenance of lines of text."""
    try:
        _PROVENANCE.validate_json(row.provenance)
        timing = None if row.timing is None else _NUMBERS.validate_json(row.timing)
    except ValidationError:
        return False
    if timing is None:
        return True
    if timing.keys() != set(_TIMING) or None in (timing[name] for name in _TIMING[:4]):
        return False
    if timing["cores"] is not None and not (type(timing["cores"]) is int and timing["cores"] >= 1):
        return False
    return all(0 <= number < _LATEST for number in timing.values() if number is not None)


def policy_of_training(database: Database, digest: str) -> bytes | None:
    """The policy of a training; its checkpoint while it has no result."""
    with database.read() as session:
        result = find_result(session, digest)
        if result is not None:
            return result.blobs.get("policy")
        checkpoint = session.get(CheckpointRow, digest)
        row = session.get(ArtifactRow, checkpoint.sha256) if checkpoint else None
        return row.content if row else None


def artifact(database: Database, digest: str) -> bytes | None:
    """The bytes with this SHA-256."""
    with database.read() as session:
        row = session.get(ArtifactRow, digest)
        return None if row is None else row.content


def add_artifact(session: Session, content: bytes) -> str:
    """Store bytes, once, and return their SHA-256; inside a transaction."""
    key = sha256(content)
    if session.get(ArtifactRow, key) is None:
        session.add(ArtifactRow(sha256=key, size=len(content), content=content))
        session.flush()
    return key


def is_mentioned_by(runs: Select[str]) -> ColumnElement[bool]:
    """The condition that an event of these runs names the stage, for queries of StageRow."""
    return exists().where(_MENTIONED, EventRow.run_id.in_(runs))


def mentioned_by(session: Session, run_id: str) -> list[str]:
    """Digests of the stored stages that a run's events name; inside a transaction."""
    mine = select(StageRow.digest).join(EventRow, _OF_EVENT).where(EventRow.run_id == run_id)
    return list(session.scalars(mine.order_by(EventRow.seq)))


def copy_result(session: Session, source: Session, digest: str) -> bool:
    """Copy a stage and its artifacts from another database; False if it is here already."""
    if session.get(StageRow, digest) is not None:
        return False
    session.add(copy_of(source.get_one(StageRow, digest)))
    session.flush()
    session.add(ImportedStageRow(digest=digest))
    for name, key in _parts(source, digest).items():
        add_artifact(session, source.get_one(ArtifactRow, key).content)
        session.add(StageArtifactRow(digest=digest, name=name, sha256=key))
    session.flush()
    _drop_checkpoint(session, digest)
    return True


def has_other_result(session: Session, source: Session, digest: str) -> bool:
    """True if a stage has results in two databases, and they differ."""
    here, there = session.get(StageRow, digest), source.get_one(StageRow, digest)
    if here is None:
        return False
    return here.result != there.result or _parts(session, digest) != _parts(source, digest)


def has_unreferenced(session: Session) -> bool:
    """True if there are results that no run's events mention, or bytes that nothing has."""
    lost = (select(StageRow.digest).where(_UNMENTIONED), select(ArtifactRow.sha256).where(*_UNUSED))
    return any(session.scalar(query.limit(1)) is not None for query in lost)


def delete_unmentioned(session: Session) -> None:
    """Delete results and checkpoints that no run's events mention; inside a transaction."""
    session.execute(delete(StageRow).where(_UNMENTIONED))
    # `note_checkpoint` comes with that point of the learning curve, which an index finds
    steps = cast(CheckpointRow.steps, String)
    point = f"{type_of(TrainingEvaluated)}:" + CheckpointRow.digest + ":" + steps
    session.execute(delete(CheckpointRow).where(~exists().where(EventRow.key == point)))


def delete_unused_artifacts(session: Session) -> None:
    """Delete bytes that no stage, checkpoint, dataset or visit has; inside a transaction."""
    session.execute(delete(ArtifactRow).where(*_UNUSED))


def _parts(session: Session, digest: str) -> dict[str, str]:
    """SHA-256 of a stored stage's binary parts, by name."""
    columns = select(StageArtifactRow.name, StageArtifactRow.sha256)
    stored = session.execute(columns.where(StageArtifactRow.digest == digest))
    return {row.name: row.sha256 for row in stored}


def _row(digest: str, document: str, result: StageResult, execution: Execution) -> StageRow:
    timing = {name: getattr(execution, name) for name in _TIMING}
    return StageRow(
        digest=digest,
        kind=json.loads(document)["kind"],
        document=document,
        result=canonical_json(result.values),
        attempt=execution.attempt,
        started_by=execution.started_by,
        seconds=execution.seconds,
        timing=canonical_json(timing) if execution.is_measured else None,
        provenance=canonical_json(execution.provenance),
        created_at=datetime.now(UTC),
    )


def _executions() -> Select[str, str, int, str, str | None, str]:
    return select(
        *(StageRow.digest, StageRow.kind, StageRow.attempt, StageRow.started_by),
        *(StageRow.timing, StageRow.provenance),
    ).where(_MEASURED)


def _execution(row: _ExecutionRow) -> Execution:
    timing, provenance = json.loads(row.timing or "{}"), json.loads(row.provenance)
    return Execution(
        attempt=row.attempt, started_by=row.started_by, provenance=provenance, **timing
    )


def _drop_checkpoint(session: Session, digest: str) -> None:
    row = session.get(CheckpointRow, digest)
    if row is not None:
        session.delete(row)
        session.flush()
        session.execute(delete(ArtifactRow).where(ArtifactRow.sha256 == row.sha256, *_UNUSED))

"""Benchmarks leave the database as one file, and come back into any other.

    export_benchmark(database, benchmark_id, file)
    with staged(file, folder) as archived:
        imported = import_benchmark(database, archived)

An import only adds: runs, events after those that a run has, and stages with their artifacts. It
adds run by run, so an import that was interrupted is finished by another.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import IO, Any, Literal

from sqlalchemy import ColumnElement, Select, select
from sqlalchemy.orm import Session

import adr_service
from adr_service.benchmark.archive import ArchiveWriter, Manifest
from adr_service.events import RunState, RunStopped
from adr_service.json_values import Wire
from adr_service.specs import BenchmarkSpec, RunSpec
from db.archive_checks import replays
from db.benchmarks import cell_of, get_benchmark, runs_of
from db.errors import NotPossible
from db.events import append, run_row
from db.models import (
    NUMBER,
    ArtifactRow,
    Base,
    BenchmarkRow,
    EventRow,
    RunRow,
    StageArtifactRow,
    StageRow,
    copy_of,
)
from db.runs import RunRecord, list_runs, unfinished_runs
from db.session import Database
from db.stages import copy_result, has_other_result, is_mentioned_by, mentioned_by
from db.staging import Staged

_IN_BATCHES = {"yield_per": 100}
_ONE_BY_ONE = {"yield_per": 1}  # artifacts may be large
Outcome = Literal["added", "continued", "unchanged", "left"]


class Imported(Wire):
    """What an import added."""

    benchmark: str  # its id
    runs: int  # of the archive
    added: int  # runs that were not there
    continued: int  # runs that got further events
    unchanged: int  # runs that had all of it
    left: list[str]  # ids of runs that go on here, or went on otherwise, and stay as they are
    stages: int  # that were not there
    replayed: int  # runs whose events follow from their results, to the end


def export_benchmark(database: Database, benchmark_id: str, file: IO[bytes]) -> None:
    """Write a benchmark as it is at one moment, finished or not. Raises NotFound."""
    get_benchmark(database, benchmark_id)
    with database.read() as session, ArchiveWriter(file) as archive:
        for table, query in _tables(benchmark_id):
            rows = session.execute(query, execution_options=_IN_BATCHES).mappings()
            archive.add_rows(table.__tablename__, map(_as_json, rows))
        for content in session.scalars(_artifacts(benchmark_id), execution_options=_ONE_BY_ONE):
            archive.add_blob(content)
        provenance = select(StageRow.provenance).where(_is_mine(benchmark_id)).distinct()
        manifest = Manifest(
            benchmark=benchmark_id,
            adr_service=adr_service.__version__,
            revision=str(database.revision()),
            computed_with=[json.loads(text) for text in sorted(session.scalars(provenance))],
        )
        archive.finish(manifest)


def import_benchmark(database: Database, archived: Staged) -> Imported:
    """Check an archive, and add what the database lacks of it. What is there stays as it is.

    Runs that had not finished are stopped, and go on when they are resumed. Raises InvalidInput for
    an archive that contradicts itself, and NotPossible for one that contradicts the database; then
    nothing was added.
    """
    replayed = sum(replay.is_complete for _, replay in replays(archived))
    source, id = archived.database, archived.manifest.benchmark
    _stop_unfinished(source)
    records = runs_of(source, id)
    _check_compatible(database, source, records)
    _add_benchmark(database, source, id)
    stages, outcomes = 0, dict[str, Outcome]()
    for record in records:
        outcomes[record.id], new = _add_run(database, source, record.id)
        stages += new
    count = Counter(outcomes.values())
    return Imported(
        benchmark=id,
        runs=len(records),
        added=count["added"],
        continued=count["continued"],
        unchanged=count["unchanged"],
        left=[id for id, outcome in outcomes.items() if outcome == "left"],
        stages=stages,
        replayed=replayed,
    )


def _tables(benchmark_id: str) -> list[tuple[type[Base], Select[Any]]]:
    """The queries of a benchmark's rows, parents first."""
    mine = _is_mine(benchmark_id)
    parts = StageArtifactRow.digest.in_(select(StageRow.digest).where(mine))
    return [
        (BenchmarkRow, _rows(BenchmarkRow).where(BenchmarkRow.id == benchmark_id)),
        (RunRow, _rows(RunRow).where(RunRow.benchmark_id == benchmark_id).order_by(RunRow.number)),
        (
            EventRow,
            _rows(EventRow)
            .join(RunRow, RunRow.id == EventRow.run_id)
            .where(RunRow.benchmark_id == benchmark_id)
            .order_by(RunRow.number, EventRow.seq),
        ),
        (StageRow, _rows(StageRow).where(mine).order_by(StageRow.digest)),
        (
            StageArtifactRow,
            _rows(StageArtifactRow)
            .where(parts)
            .order_by(StageArtifactRow.digest, StageArtifactRow.name),
        ),
    ]


def _artifacts(benchmark_id: str) -> Select[bytes]:
    parts = StageArtifactRow.digest.in_(select(StageRow.digest).where(_is_mine(benchmark_id)))
    owned = ArtifactRow.sha256.in_(select(StageArtifactRow.sha256).where(parts))
    return select(ArtifactRow.content).where(owned).order_by(ArtifactRow.sha256)


def _is_mine(benchmark_id: str) -> ColumnElement[bool]:
    """The condition that a run of the benchmark mentions the stage."""
    return is_mentioned_by(select(RunRow.id).where(RunRow.benchmark_id == benchmark_id))


def _rows(table: type[Base]) -> Select[Any]:
    return select(*(column for column in table.__table__.columns if column.name != NUMBER))


def _as_json(row: Mapping[Any, Any]) -> dict[str, Any]:
    return {
        str(name): value.isoformat() if isinstance(value, datetime) else value
        for name, value in row.items()
    }


def _stop_unfinished(source: Database) -> None:
    """Stop the runs of an archive that had not finished, as a user would."""
    for record in unfinished_runs(source):
        with source.write("stop_archived") as session:
            append(session, record.id, RunStopped(submission=record.submission))


def _check_compatible(database: Database, source: Database, records: list[RunRecord]) -> None:
    """Raise NotPossible if a run or a stage of the same name is another one here."""
    id = records[0].benchmark_id
    present = list_runs(database, benchmark_id=id, limit=None)
    places = {_place(run): run.id for run in present}
    with database.read() as session, source.read() as archived:
        for record in records:
            here, there = _run(session, record.id), run_row(archived, record.id)
            if here is not None and (here.benchmark_id, here.spec) != (id, there.spec):
                raise NotPossible(f"{record.id} is another run here than in the archive")
            if places.get(_place(record), record.id) != record.id:
                raise NotPossible(f"{id} was extended both here and in the archive")
            for digest in mentioned_by(archived, record.id):
                if has_other_result(session, archived, digest):
                    raise NotPossible(
                        f"stage {digest} has another result here than in the archive, perhaps from "
                        "another type of CPU: import it into a database without that stage "
                        "(--data-dir), or delete the runs that have it here"
                    )


def _add_benchmark(database: Database, source: Database, id: str) -> None:
    """Add a benchmark, or the members by which it was extended."""
    archived = get_benchmark(source, id)
    with database.write("import_benchmark") as session, source.read() as there:
        row = session.scalar(select(BenchmarkRow).where(BenchmarkRow.id == id))
        theirs = there.scalars(select(BenchmarkRow)).one()
        if row is None:
            session.add(copy_of(theirs))
        elif row.spec != theirs.spec:
            ours, new = _cells(get_benchmark(database, id).spec), _cells(archived.spec)
            if ours < new:
                row.spec = theirs.spec
            elif not new < ours:
                raise NotPossible(f"{id} is another benchmark here than in the archive")


def _add_run(database: Database, source: Database, id: str) -> tuple[Outcome, int]:
    """Add what a run here lacks of the archived one; return the number of new stages too."""
    with database.write("import_run") as session, source.read() as archived:
        here, there = _run(session, id), run_row(archived, id)
        known, events = _events(session, id), _events(archived, id)
        if here is None:
            session.add(copy_of(there))
            session.flush()
        elif _same(known, events[: len(known)]) and RunState(here.state).is_finished:
            _bring_up(here, there)
        else:
            return "unchanged" if _same(events, known[: len(events)]) else "left", 0
        session.add_all(copy_of(event) for event in events[len(known) :])
        session.flush()
        new = [copy_result(session, archived, digest) for digest in mentioned_by(archived, id)]
        if here is None:
            return "added", sum(new)
        return "continued" if len(events) > len(known) else "unchanged", sum(new)


def _bring_up(here: RunRow, there: RunRow) -> None:
    """Give a run the state that its further events lead to."""
    for name in ("state", "submission", "cancel_requested", "error_code", "error_message"):
        setattr(here, name, getattr(there, name))
    here.updated_at = max(here.updated_at, there.updated_at)


def _same(some: Sequence[EventRow], others: Sequence[EventRow]) -> bool:
    return [(e.key, e.body) for e in some] == [(e.key, e.body) for e in others]


def _events(session: Session, run_id: str) -> Sequence[EventRow]:
    mine = select(EventRow).where(EventRow.run_id == run_id)
    return session.scalars(mine.order_by(EventRow.seq)).all()


def _run(session: Session, id: str) -> RunRow | None:
    return session.scalar(select(RunRow).where(RunRow.id == id))


def _place(record: RunRecord) -> tuple[str, str, str, int] | None:
    return cell_of(record.spec) if isinstance(record.spec, RunSpec) else None


def _cells(spec: BenchmarkSpec) -> set[tuple[str, str, str, int]]:
    return {cell_of(run) for run in spec.runs()}

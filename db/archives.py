"""Benchmarks leave the database as one file, and come back into any other.

    export_benchmark(database, benchmark_id, file)      # or a part of it
    with staged(file, folder) as archived:
        imported = import_benchmark(database, archived)

An import only adds: runs, events after those that a run has, and stages with their artifacts. It
adds run by run, so an import that was interrupted is finished by another.
"""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import IO, Any, Literal

from sqlalchemy import ColumnElement, Select, func, select
from sqlalchemy.orm import Session

import adr_service
from adr_service.benchmark.archive import ArchiveWriter, Manifest
from adr_service.errors import InvalidInput
from adr_service.events import RunState, RunStopped, type_of
from adr_service.json_values import Wire
from adr_service.specs import BenchmarkPart, BenchmarkSpec, CriticismSpec
from db.archive_checks import replays
from db.benchmarks import (
    Cell,
    cell_of,
    get_benchmark,
    grid_of,
    part_of,
    readable,
    runs_of,
    stored,
)
from db.errors import NotPossible
from db.events import append
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
    find_row,
    get_row,
)
from db.runs import RunRecord, record_of, unfinished_runs
from db.session import Database
from db.stages import (
    copy_result,
    has_other_result,
    is_mentioned_by,
    mentioned_by,
    versions_of,
)
from db.staging import Staged

_IN_BATCHES = {"yield_per": 100}
_WHOLE = BenchmarkPart()
_CHANGED = "updated_at"
_IN_ORDER = (RunRow.created_at, RunRow.number)  # numbers are of the order of imports
_STOPPED = type_of(RunStopped)
_ONE_BY_ONE = {"yield_per": 1}  # artifacts may be large
Change = Literal["added", "continued", "unchanged", "left"]


class Imported(Wire):
    """Report of an import."""

    benchmark: str  # its id
    runs: int  # of the archive
    added: int  # runs that were not there
    continued: int  # runs that got further events
    unchanged: int  # runs that had all of it
    left: list[str]  # ids of runs that are live here, or went on apart, and stay as they are
    stages: int  # that were not there
    unverified: list[str]  # ids of runs with events that could not be computed again
    resumable: int  # runs of the benchmark that stopped before their end, and can be resumed


def export_benchmark(
    database: Database,
    benchmark_id: str,
    file: IO[bytes],
    part: BenchmarkPart = _WHOLE,
    check: Callable[[], None] | None = None,
) -> None:
    """Write a benchmark as it is at one moment, finished or not.

    A part is written as a benchmark of these members alone. Parts that differ in one kind of
    member, as in their methods, are one benchmark again when they are imported one after the other.
    Raises NotFound, what `part_of` raises, and what `check` raises, which is called before each
    artifact.
    """
    with database.read() as session, ArchiveWriter(file) as archive:
        benchmark, runs = _chosen(session, benchmark_id, part)
        archive.add_rows(BenchmarkRow.__tablename__, [benchmark])
        for table, query in _tables(runs):
            rows = session.execute(query, execution_options=_IN_BATCHES).mappings()
            archive.add_rows(table.__tablename__, map(_as_json, rows))
        for content in session.scalars(_artifacts(runs), execution_options=_ONE_BY_ONE):
            if check is not None:
                check()
            archive.add_blob(content)
        provenance = select(StageRow.provenance).where(_is_mine(runs)).distinct()
        run_ids = list(session.scalars(select(RunRow.id).where(runs)))
        packages = sorted(versions_of(session, run_ids).packages)
        manifest = Manifest(
            benchmark=benchmark_id,
            adr_service=adr_service.__version__,
            revision=str(database.revision()),
            computed_with=[
                *(json.loads(text) for text in sorted(session.scalars(provenance))),
                *({name: version} for name, version in packages),
            ],
        )
        archive.finish(manifest)


def import_benchmark(database: Database, archived: Staged) -> Imported:
    """Check an archive, and add what the database lacks of it. What is there stays as it is.

    Runs that had not finished are stopped, and go on when they are resumed. Raises InvalidInput for
    an archive that contradicts itself, and NotPossible for one that contradicts the database.
    Nothing was added then, unless the contradiction came up meanwhile.
    """
    unverified = [checked.id for checked in replays(archived) if not checked.is_verified]
    source, id = archived.database, archived.manifest.benchmark
    _stop_unfinished(source)
    records = runs_of(source, id)
    for record in records:
        with database.read() as session, source.read() as there:
            _check_compatible(session, there, id, record)
    _add_benchmark(database, source, id)
    stages, changes = 0, dict[str, Change]()
    for record in records:
        changes[record.id], new = _add_run(database, source, id, record)
        stages += new
    count = Counter(changes.values())
    return Imported(
        benchmark=id,
        runs=len(records),
        added=count["added"],
        continued=count["continued"],
        unchanged=count["unchanged"],
        left=[run_id for run_id, change in changes.items() if change == "left"],
        stages=stages,
        unverified=unverified,
        resumable=sum(run.state.is_resumable for run in runs_of(database, id)),
    )


def _chosen(
    session: Session, benchmark_id: str, part: BenchmarkPart
) -> tuple[dict[str, Any], ColumnElement[bool]]:
    """The row of a benchmark or of its part, and the condition of its runs."""
    row = get_row(session, BenchmarkRow, benchmark_id)
    columns = BenchmarkRow.__table__.columns
    written = _as_json({column.name: getattr(row, column.name) for column in columns})
    if part.is_whole:
        return written, RunRow.benchmark_id == benchmark_id
    spec, chosen = part_of(session, benchmark_id, part)
    return written | {"spec": stored(spec)}, RunRow.id.in_(chosen)


def _tables(runs: ColumnElement[bool]) -> list[tuple[type[Base], Select[Any]]]:
    """The queries of the rows of a benchmark's runs, parents first."""
    mine = _is_mine(runs)
    parts = StageArtifactRow.digest.in_(select(StageRow.digest).where(mine))
    return [
        (RunRow, _run_rows().where(runs).order_by(*_IN_ORDER)),
        (
            EventRow,
            _rows(EventRow)
            .join(RunRow, RunRow.id == EventRow.run_id)
            .where(runs)
            .order_by(*_IN_ORDER, EventRow.seq),
        ),
        (StageRow, _rows(StageRow).where(mine).order_by(StageRow.digest)),
        (
            StageArtifactRow,
            _rows(StageArtifactRow)
            .where(parts)
            .order_by(StageArtifactRow.digest, StageArtifactRow.name),
        ),
    ]


def _artifacts(runs: ColumnElement[bool]) -> Select[bytes]:
    parts = StageArtifactRow.digest.in_(select(StageRow.digest).where(_is_mine(runs)))
    owned = ArtifactRow.sha256.in_(select(StageArtifactRow.sha256).where(parts))
    return select(ArtifactRow.content).where(owned).order_by(ArtifactRow.sha256)


def _is_mine(runs: ColumnElement[bool]) -> ColumnElement[bool]:
    """The condition that one of the runs mentions the stage."""
    return is_mentioned_by(select(RunRow.id).where(runs))


def _rows(table: type[Base]) -> Select[Any]:
    return select(*table.__table__.columns)


def _run_rows() -> Select[Any]:
    """Rows of runs, which have changed when their last event happened, on whatever machine."""
    last = select(func.max(EventRow.created_at)).where(EventRow.run_id == RunRow.id)
    changed = func.coalesce(last.scalar_subquery(), RunRow.created_at).label(_CHANGED)
    return select(*(c for c in RunRow.__table__.columns if c.name != _CHANGED), changed)


def _as_json(row: Mapping[Any, Any]) -> dict[str, Any]:
    return {
        str(name): value.isoformat() if isinstance(value, datetime) else value
        for name, value in row.items()
        if name != NUMBER
    }


def _stop_unfinished(source: Database) -> None:
    """Stop the runs of an archive that had not finished, as a user would."""
    for record in unfinished_runs(source):
        with source.write("stop_archived") as session:
            append(session, record.id, RunStopped(submission=record.submission))
    if unfinished_runs(source):
        raise InvalidInput("the archive has runs that were stopped, and go on unasked")


def _check_compatible(session: Session, there: Session, id: str, record: RunRecord) -> None:
    """Raise NotPossible if a run, its place or a stage of it is another one here."""
    here, theirs = find_row(session, RunRow, record.id), get_row(there, RunRow, record.id)
    if here is not None and (here.benchmark_id, here.spec) != (id, theirs.spec):
        raise NotPossible(f"{record.id} is another run here than in the archive")
    mine = (RunRow.benchmark_id == id, RunRow.seed == record.spec.seed, RunRow.id != record.id)
    for other in session.scalars(select(RunRow).where(*mine, RunRow.task == record.spec.task)):
        if _place(record_of(other)) == _place(record):
            raise NotPossible(f"{id} was extended both here and in the archive")
    for digest in mentioned_by(there, record.id):
        if has_other_result(session, there, digest):
            raise NotPossible(
                f"stage {digest} has another result here than in the archive, perhaps from another "
                "type of CPU: import it into a database without that stage (--data-dir), or delete "
                "the runs that have it here"
            )


def _add_benchmark(database: Database, source: Database, id: str) -> None:
    """Add a benchmark, or the members by which it was extended."""
    archived = get_benchmark(source, id)
    with database.write("import_benchmark") as session, source.read() as there:
        row = find_row(session, BenchmarkRow, id)
        theirs = there.scalars(select(BenchmarkRow)).one()
        if row is None:
            session.add(copy_of(theirs))
        elif row.spec != theirs.spec:
            row.spec = stored(_joined(readable(get_benchmark(database, id)), readable(archived)))


def _joined(ours: BenchmarkSpec, theirs: BenchmarkSpec) -> BenchmarkSpec:
    """A benchmark of the members that are here and in an archive, if its runs are those of both."""
    joined = ours.joined(theirs)
    grid, here, there = grid_of(joined), grid_of(ours), grid_of(theirs)
    if lacking := grid.keys() - here.keys() - there.keys():
        raise NotPossible(
            "the benchmark has other members here than in the archive, and together they lack "
            f"{len(lacking)} runs, as {' '.join(map(str, min(lacking)))}; archives fit together if "
            "they differ in one kind of member: tasks, variants, methods, collectors or seeds"
        )
    for cell, run in (*here.items(), *there.items()):
        if grid.get(cell) != run:
            raise NotPossible(
                "the benchmark has other settings here than in the archive: in both together "
                f"{' '.join(map(str, cell))} would be another run"
            )
    return joined


def _add_run(
    database: Database, source: Database, benchmark_id: str, record: RunRecord
) -> tuple[Change, int]:
    """Add what a run here lacks of the archived one; return the number of new stages too."""
    id = record.id
    with database.write("import_run") as session, source.read() as there:
        if find_row(session, BenchmarkRow, benchmark_id) is None:
            raise NotPossible(f"{benchmark_id} was deleted while it was imported")
        _check_compatible(session, there, benchmark_id, record)
        here, archived = find_row(session, RunRow, id), get_row(there, RunRow, id)
        known, events = _events(session, id), _events(there, id)
        if here is not None and _begins(known, events):
            return "unchanged", 0
        if here is None:
            session.add(copy_of(archived))
            session.flush()
            get_row(session, RunRow, id).updated_at = datetime.now(UTC)  # from when on it is kept
        elif _begins(events, known) and RunState(here.state).is_finished:
            _bring_up(here, archived)
        else:
            return "left", 0
        keys = {event.key for event in known}
        for seq, event in enumerate((e for e in events if e.key not in keys), len(known) + 1):
            row = copy_of(event)
            row.seq = seq
            session.add(row)
        session.flush()
        new = [copy_result(session, there, digest) for digest in mentioned_by(there, id)]
    return ("added" if here is None else "continued"), sum(new)


def _bring_up(here: RunRow, there: RunRow) -> None:
    """Give a run the state that its further events lead to."""
    for name in ("state", "submission", "cancel_requested", "error_code", "error_message"):
        setattr(here, name, getattr(there, name))
    here.updated_at = datetime.now(UTC)


def _begins(events: Sequence[EventRow], first: Sequence[EventRow]) -> bool:
    """True if the events begin with `first`.

    Stops do not count: an import stops what had not finished, and a later archive may go further.
    """
    mine, start = (
        [(e.key, e.body) for e in each if e.type != _STOPPED] for each in (events, first)
    )
    return mine[: len(start)] == start


def _events(session: Session, run_id: str) -> Sequence[EventRow]:
    mine = select(EventRow).where(EventRow.run_id == run_id)
    return session.scalars(mine.order_by(EventRow.seq)).all()


def _place(record: RunRecord) -> Cell | None:
    return None if isinstance(record.spec, CriticismSpec) else cell_of(record.spec)

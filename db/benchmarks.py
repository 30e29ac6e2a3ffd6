"""Benchmarks: grids of runs that are stored, extended, cancelled and deleted as one.

benchmark = create_benchmark(database, spec)           # with all its runs, or nothing
runs_of(database, benchmark.id)
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache, partial

from pydantic import BaseModel, ValidationError
from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from adr_service.errors import InvalidInput
from adr_service.events import FINISHED, RunState
from adr_service.json_values import explain
from adr_service.specs import (
    BenchmarkExtension,
    BenchmarkPart,
    BenchmarkSpec,
    LostBenchmark,
    LostRun,
    RunSpec,
)
from adr_service.specs.lost import Lost
from db.errors import DatabaseDamaged, NotPossible
from db.models import BenchmarkRow, RunRow, get_row
from db.references import delete_unreferenced
from db.requests import RequestKey, check_new, once
from db.results import delete_results
from db.runs import (
    Accept,
    RunRecord,
    batches,
    check_live,
    delete_run,
    document_of,
    insert_runs,
    list_runs,
    new_id,
    new_run,
    queue_again,
    record_of,
)
from db.session import Database
from db.stages import check_versions

Cell = tuple[str, str, str, int]  # task, variant, method with its collector, seed


@dataclass(frozen=True)
class BenchmarkRecord:
    """A submitted benchmark."""

    number: int  # order of submission
    id: str
    created_at: datetime
    spec: BenchmarkSpec | LostBenchmark  # as it was submitted, and extended since


def create_benchmark(
    database: Database,
    spec: BenchmarkSpec,
    key: RequestKey | None = None,
    accept: Accept | None = None,
) -> BenchmarkRecord:
    """Store a benchmark and all its runs, or nothing. Raises as `create_run` does."""
    row = BenchmarkRow(id=new_id("bench"), created_at=datetime.now(UTC), spec=stored(spec))
    members = [new_run(run, row.id) for run in spec.runs()]  # before the lock: it takes a while
    with database.write("create_benchmark") as session:
        session.add(row)
        session.flush()
        once(session, key, row.id)
        insert_runs(session, members)
        check_live(session, accept)
        return BenchmarkRecord(row.number, row.id, row.created_at, spec)


def get_benchmark(database: Database, benchmark_id: str) -> BenchmarkRecord:
    """The benchmark with this id. Raises NotFound."""
    with database.read() as session:
        return _record(get_row(session, BenchmarkRow, benchmark_id))


def list_benchmarks(
    database: Database, *, after: int = 0, limit: int = 100
) -> list[BenchmarkRecord]:
    """Benchmarks in order of submission, those numbered above `after`."""
    query = select(BenchmarkRow).where(BenchmarkRow.number > after)
    with database.read() as session:
        rows = session.scalars(query.order_by(BenchmarkRow.number).limit(limit))
        return [_record(row) for row in rows]


def latest(database: Database, limit: int) -> tuple[list[BenchmarkRecord], list[RunRecord]]:
    """The newest benchmarks, and the newest runs that belong to none; newest first."""
    benchmarks = select(BenchmarkRow).order_by(BenchmarkRow.number.desc()).limit(limit)
    single = select(RunRow).where(RunRow.benchmark_id.is_(None))
    runs = single.order_by(RunRow.number.desc()).limit(limit)
    with database.read() as session:
        return (
            [_record(row) for row in session.scalars(benchmarks)],
            [record_of(row) for row in session.scalars(runs)],
        )


def runs_of(database: Database, benchmark_id: str) -> list[RunRecord]:
    """All runs of a benchmark, in order. Raises NotFound."""
    get_benchmark(database, benchmark_id)
    return list_runs(database, benchmark_id=benchmark_id, limit=None)


def states_of(database: Database, benchmark_ids: Sequence[str]) -> dict[str, dict[str, int]]:
    """The number of runs in each state, by benchmark."""
    states: dict[str, dict[str, int]] = {id: {} for id in benchmark_ids}
    mine = RunRow.benchmark_id.in_(benchmark_ids)
    query = select(RunRow.benchmark_id, RunRow.state, func.count(), func.min(RunRow.number))
    grouped = query.where(mine).group_by(RunRow.benchmark_id, RunRow.state)
    with database.read() as session:
        for id, state, count, _ in session.execute(grouped.order_by(func.min(RunRow.number))):
            states[str(id)][state] = count
    return states


def changes_of(database: Database, benchmark_ids: Sequence[str]) -> dict[str, datetime]:
    """When a benchmark's runs changed last, by benchmark."""
    mine = RunRow.benchmark_id.in_(benchmark_ids)
    query = select(RunRow.benchmark_id, func.max(RunRow.updated_at)).where(mine)
    with database.read() as session:
        return {str(id): last for id, last in session.execute(query.group_by(RunRow.benchmark_id))}


def extend_benchmark(
    database: Database,
    benchmark_id: str,
    extension: BenchmarkExtension,
    key: RequestKey | None = None,
    accept: Accept | None = None,
) -> list[RunRecord]:
    """Add runs to a benchmark, and return them; the runs that it has stay as they are.

    Raises NotFound, Replayed if the key has extended it before, InvalidInput if the extension adds
    nothing or a package has another version since, NotPossible if the new runs would not compare
    with the old ones or another request was faster, and what `accept` raises.
    """
    now = get_benchmark(database, benchmark_id)
    spec, specs = _extended(database, now, extension, key)
    new = [new_run(run, benchmark_id) for run in specs]  # before the lock
    with database.write("extend_benchmark") as session:
        once(session, key, benchmark_id)
        row = get_row(session, BenchmarkRow, benchmark_id)
        if _spec(row.spec) != now.spec:
            raise NotPossible(f"{benchmark_id} was extended by another request just now; try again")
        row.spec = stored(spec)
        added = set(insert_runs(session, new))
        check_live(session, accept)
    return [run for run in runs_of(database, benchmark_id) if run.id in added]


def planned_extension(
    database: Database,
    benchmark_id: str,
    extension: BenchmarkExtension,
    key: RequestKey | None = None,
) -> tuple[BenchmarkSpec, list[RunSpec]]:
    """The spec of a benchmark with an extension, and its new runs. Raises as `extend_benchmark`."""
    return _extended(database, get_benchmark(database, benchmark_id), extension, key)


def request_cancel_all(database: Database, benchmark_id: str) -> list[RunRecord]:
    """Ask all live runs of a benchmark to stop, and return them. Raises NotFound."""
    get_benchmark(database, benchmark_id)
    live = (RunRow.benchmark_id == benchmark_id, RunRow.state.not_in(FINISHED))
    with database.write("request_cancel_all") as session:
        session.execute(update(RunRow).where(*live).values(cancel_requested=True))
        return [record_of(row) for row in session.scalars(select(RunRow).where(*live))]


def resubmit_all(
    database: Database, benchmark_id: str, accept: Accept | None = None
) -> Iterator[RunRecord]:
    """Queue all failed and cancelled runs of a benchmark again, and yield them.

    Each batch is a transaction; what `accept` raises ends it, and earlier batches stay queued.
    Raises InvalidInput before the first if a package or a kind of stage has another version since.
    """
    present = runs_of(database, benchmark_id)
    check_versions(database, benchmark_id, [run.id for run in present])
    stopped = [run.id for run in present if run.state.is_resumable]
    for batch in batches(stopped):
        with database.write("resubmit_all") as session:
            rows = [get_row(session, RunRow, run_id) for run_id in batch]
            # another request may have been faster
            mine = [row for row in rows if RunState(row.state).is_resumable]
            for row in mine:
                queue_again(session, row)
            check_live(session, accept)
            queued = [record_of(row) for row in mine]
        yield from queued


def delete_benchmark(database: Database, benchmark_id: str, since: datetime | None = None) -> None:
    """Delete a finished benchmark with its runs and what only they refer to.

    Raises NotFound, and NotPossible if a run of it is not finished, or has changed after `since`.
    """
    with database.write("delete_benchmark") as session:
        row = get_row(session, BenchmarkRow, benchmark_id)
        mine = RunRow.benchmark_id == benchmark_id
        if session.scalar(select(RunRow.id).where(mine, RunRow.state.not_in(FINISHED)).limit(1)):
            raise NotPossible(f"benchmark {benchmark_id} is not finished; cancel it first")
        if since and session.scalar(select(RunRow.id).where(mine, RunRow.updated_at >= since)):
            raise NotPossible(f"benchmark {benchmark_id} has changed meanwhile")
        delete_results(session, [benchmark_id])
        delete_results(session, select(RunRow.id).where(mine))
        session.execute(delete(RunRow).where(mine))
        session.delete(row)
        session.flush()
        delete_unreferenced(session)


Deletion = tuple[Callable[[Database, str], None], str]  # the function that deletes, and the id


def finished_before(database: Database, moment: datetime) -> list[Deletion]:
    """Deletions of the benchmarks and single runs that have not changed since `moment`."""
    is_recent = RunRow.state.not_in(FINISHED) | (RunRow.updated_at >= moment)
    member = RunRow.benchmark_id == BenchmarkRow.id
    has_recent = select(RunRow.id).where(member, is_recent).exists()
    has_runs = select(RunRow.id).where(member).exists()  # an import adds them after it
    single = select(RunRow.id).where(RunRow.benchmark_id.is_(None), ~is_recent)
    with database.read() as session:
        benchmarks = session.scalars(select(BenchmarkRow.id).where(has_runs, ~has_recent)).all()
        return [
            *((partial(delete_benchmark, since=moment), id) for id in benchmarks),
            *((partial(delete_run, since=moment), id) for id in session.scalars(single)),
        ]


def _extended(
    database: Database,
    now: BenchmarkRecord,
    extension: BenchmarkExtension,
    key: RequestKey | None,
) -> tuple[BenchmarkSpec, list[RunSpec]]:
    """The spec of a benchmark with an extension, and its new runs."""
    present = runs_of(database, now.id)
    with database.read() as session:
        check_new(session, key)  # last: if it was carried out before `present`, it is known by now
    spec = readable(now).extended(extension)
    new = _missing(now, spec, present)
    if not new:
        raise InvalidInput(
            "the extension adds no run: its methods are there already, as references, or its "
            "collectors have no method that learns from recordings"
        )
    check_versions(database, now.id, [run.id for run in present])
    return spec, new


def _missing(
    now: BenchmarkRecord, spec: BenchmarkSpec, present: Sequence[RunRecord]
) -> list[RunSpec]:
    """The runs that `spec` has and a benchmark with the runs `present` lacks.

    Raises NotPossible if the benchmark lacks runs that its own spec has, or if a run of it differs
    from the one that `spec` has in its place.
    """
    known = {cell_of(before): before for before in map(_member, present)}
    if lacking := grid_of(readable(now)).keys() - known.keys():
        raise NotPossible(
            f"{now.id} lacks {len(lacking)} of its own runs, as "
            f"{' '.join(map(str, min(lacking)))}: its archive was not imported to the end; import "
            "it again first"
        )
    new: list[RunSpec] = []
    for cell, run in grid_of(spec).items():
        before = known.get(cell)
        if before is None:
            new.append(run)
        elif before != run:
            raise NotPossible(
                f"the new runs would differ from those that {now.id} has in "
                f"{', '.join(_differences(before, run))}, and would not compare with them: the "
                f"preset {run.preset!r}, the SimOpt that others learn from, or the installed "
                "packages (as sbx-rl) have changed since"
            )
    return new


def _differences(before: BaseModel, now: BaseModel, prefix: str = "") -> Iterator[str]:
    """The fields in which two specs differ, each with both values."""
    for name, value in now:
        former = getattr(before, name, None)
        if former == value:
            continue
        if isinstance(value, BaseModel) and isinstance(former, type(value)):
            yield from _differences(former, value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name} ({former!r} there, {value!r} now)"


def _member(run: RunRecord) -> RunSpec:
    """The spec of a benchmark's run; raises Lost where nobody knows what takes its place."""
    if isinstance(run.spec, LostRun):
        raise Lost(run.spec.reason)
    assert isinstance(run.spec, RunSpec), "criticisms belong to no benchmark"
    return run.spec


def part_of(
    session: Session, benchmark_id: str, part: BenchmarkPart
) -> tuple[BenchmarkSpec, list[str]]:
    """A benchmark of some members alone, and the ids of its runs; inside a transaction.

    Raises NotFound, Lost if the benchmark has runs that cannot be read, and InvalidInput for
    members that it does not have, or that would not be the same ones without the others.
    """
    whole = readable(_record(get_row(session, BenchmarkRow, benchmark_id)))
    spec = whole.part(part)
    grid, cells = grid_of(whole), grid_of(spec)
    if changed := [cell for cell, run in cells.items() if grid[cell] != run]:
        raise InvalidInput(
            f"{changed[0][2]} learns from this benchmark's own SimOpt, which must be in the part"
        )
    rows = session.scalars(select(RunRow).where(RunRow.benchmark_id == benchmark_id))
    return spec, [run.id for run in map(record_of, rows) if cell_of(_member(run)) in cells]


def stored(spec: BenchmarkSpec) -> str:
    """The text of a benchmark's spec: as it was submitted.

    Its runs are stored complete, and mean the same when presets change.
    """
    return spec.model_dump_json(exclude_unset=True)


def grid_of(spec: BenchmarkSpec) -> dict[Cell, RunSpec]:
    """The runs of a benchmark, each in its place."""
    return {cell_of(run): run for run in spec.runs()}


def cell_of(spec: RunSpec | LostRun) -> Cell:
    """The place of a run in its benchmark's grid."""
    return (spec.task, spec.variant, spec.column, spec.seed)


def _record(row: BenchmarkRow) -> BenchmarkRecord:
    return BenchmarkRecord(row.number, row.id, row.created_at, _spec(row.spec))


@lru_cache(maxsize=256)
def _spec(text: str) -> BenchmarkSpec | LostBenchmark:
    try:
        return BenchmarkSpec.model_validate_json(text)
    except ValidationError as error:
        document = document_of(text, "benchmark")
        try:
            return LostBenchmark.of(document, error)
        except ValidationError:
            raise DatabaseDamaged(
                f"a stored benchmark cannot be read: {explain(error, 'benchmark')}"
            ) from error


def readable(benchmark: BenchmarkRecord) -> BenchmarkSpec:
    """The spec of a benchmark; raises Lost if it cannot be read any more."""
    if isinstance(benchmark.spec, LostBenchmark):
        raise Lost(benchmark.spec.reason)
    return benchmark.spec

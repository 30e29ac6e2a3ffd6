"""Runs, benchmarks and their events; one function per transaction."""

import secrets
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import delete, func, insert, select, update
from sqlalchemy.orm import Session

from adr_service.events import (
    FINISHED,
    IterationFinished,
    RunEvent,
    RunFailed,
    RunQueued,
    RunState,
    event_from_json,
    next_state,
)
from adr_service.json_values import explain
from adr_service.specs import MAX_RUNS, AnyRun, BenchmarkExtension, BenchmarkSpec, RunSpec
from db.datasets import get_dataset
from db.errors import DatabaseDamaged, NotFound, NotPossible
from db.models import BenchmarkRow, EventRow, ResultsRow, RunRow
from db.requests import RequestKey, once
from db.session import CHUNK, Database
from db.stages import delete_unreferenced
from db.target_tasks import withdraw_tasks

T = TypeVar("T")
_AT_ONCE = 100  # runs that one transaction changes
_RESUMABLE = ("failed", "cancelled")
_ANY_RUN: TypeAdapter[AnyRun] = TypeAdapter(AnyRun)


@dataclass(frozen=True)
class RunRecord:
    number: int
    id: str
    benchmark_id: str | None
    created_at: datetime
    updated_at: datetime
    spec: AnyRun
    state: RunState
    submission: int
    cancel_requested: bool
    error_code: str | None
    error_message: str | None

    @property
    def is_finished(self) -> bool:
        return self.state in FINISHED


@dataclass(frozen=True)
class BenchmarkRecord:
    number: int
    id: str
    created_at: datetime
    spec: BenchmarkSpec


@dataclass(frozen=True)
class EventRecord:
    seq: int
    created_at: datetime
    event: RunEvent


@lru_cache(maxsize=2 * MAX_RUNS)  # parsing costs more than reading, and they never change
def _run_spec(text: str) -> AnyRun:
    with _readable("run"):
        return _ANY_RUN.validate_json(text)


@lru_cache(maxsize=256)
def _benchmark_spec(text: str) -> BenchmarkSpec:
    with _readable("benchmark"):
        return BenchmarkSpec.model_validate_json(text)


@contextmanager
def _readable(kind: str) -> Generator[None]:
    try:
        yield
    except ValidationError as error:
        raise DatabaseDamaged(
            f"a stored {kind} cannot be read ({explain(error, kind)}): a package is missing whose "
            "task or method it names, or the database is damaged (`adr db check` says where)"
        ) from error


Accept = Callable[[int], None]  # raises where so many live runs are too many


def create_run(
    database: Database,
    spec: AnyRun,
    key: RequestKey | None = None,
    accept: Accept | None = None,
) -> RunRecord:
    """Store a run; when this returns it is on disk.

    Raises NotFound where the spec names a dataset that is not there, Replayed where `key` has
    made a run before, and what `accept` raises.
    """
    with database.write("create_run") as session:
        (id,) = _insert_runs(session, [_new_run(spec, None)])
        once(session, key, id)
        _check(session, accept)
        return _record(_row(session, id))


def create_benchmark(
    database: Database,
    spec: BenchmarkSpec,
    key: RequestKey | None = None,
    accept: Accept | None = None,
) -> BenchmarkRecord:
    """Store a benchmark and all its runs, or nothing. Raises as `create_run` does."""
    # as it was given: its runs are stored complete, and mean the same when presets change
    given = spec.model_dump_json(exclude_unset=True)
    row = BenchmarkRow(id=_new_id("bench"), created_at=_now(), spec=given)
    members = [_new_run(run, row.id) for run in spec.runs()]  # before the lock: it takes a while
    with database.write("create_benchmark") as session:
        session.add(row)
        session.flush()
        once(session, key, row.id)
        _insert_runs(session, members)
        _check(session, accept)
        return _benchmark(row)


def get_run(database: Database, run_id: str) -> RunRecord:
    with database.read() as session:
        return _record(_row(session, run_id))


def list_runs(
    database: Database,
    *,
    state: str | None = None,
    method: str | None = None,
    task: str | None = None,
    benchmark_id: str | None = None,
    after: int = 0,
    limit: int | None = 100,
) -> list[RunRecord]:
    """Runs in order of submission, those numbered above `after`."""
    query = select(RunRow).where(RunRow.number > after).order_by(RunRow.number).limit(limit)
    filters = {"state": state, "method": method, "task": task, "benchmark_id": benchmark_id}
    for column, value in filters.items():
        if value is not None:
            query = query.where(getattr(RunRow, column) == value)
    with database.read() as session:
        return [_record(row) for row in session.scalars(query)]


def runs_of(database: Database, benchmark_id: str) -> list[RunRecord]:
    """All runs of a benchmark, in order."""
    get_benchmark(database, benchmark_id)
    return list_runs(database, benchmark_id=benchmark_id, limit=None)


def unfinished_runs(database: Database) -> list[RunRecord]:
    query = select(RunRow).where(RunRow.state.not_in(FINISHED)).order_by(RunRow.number)
    with database.read() as session:
        return [_record(row) for row in session.scalars(query)]


def _check(session: Session, accept: Accept | None) -> None:
    """Whether there may be as many live runs as there are now; else nothing of it is stored."""
    if accept is not None:
        live = RunRow.state.not_in(FINISHED)
        accept(session.scalar(select(func.count()).select_from(RunRow).where(live)) or 0)


def get_benchmark(database: Database, benchmark_id: str) -> BenchmarkRecord:
    with database.read() as session:
        row = session.scalar(select(BenchmarkRow).where(BenchmarkRow.id == benchmark_id))
        if row is None:
            raise NotFound("benchmark", benchmark_id)
        return _benchmark(row)


def list_benchmarks(
    database: Database, *, after: int = 0, limit: int = 100
) -> list[BenchmarkRecord]:
    query = select(BenchmarkRow).where(BenchmarkRow.number > after)
    with database.read() as session:
        rows = session.scalars(query.order_by(BenchmarkRow.number).limit(limit))
        return [_benchmark(row) for row in rows]


def latest(database: Database, limit: int) -> tuple[list[BenchmarkRecord], list[RunRecord]]:
    """The newest benchmarks, and the newest runs that belong to none; newest first."""
    benchmarks = select(BenchmarkRow).order_by(BenchmarkRow.number.desc()).limit(limit)
    single = select(RunRow).where(RunRow.benchmark_id.is_(None))
    with database.read() as session:
        return (
            [_benchmark(row) for row in session.scalars(benchmarks)],
            [
                _record(row)
                for row in session.scalars(single.order_by(RunRow.number.desc()).limit(limit))
            ],
        )


def append_event(database: Database, run_id: str, event: RunEvent) -> bool:
    """Write an event and the state it leads to; False where its key was written before."""
    with database.write(event.type) as session:
        return append(session, run_id, event)


def append_events(database: Database, events: Sequence[tuple[str, RunEvent]]) -> None:
    """`append_event` for a batch of runs, in one transaction."""
    if events:
        with database.write("append_events") as session:
            for run_id, event in events:
                if exists(session, run_id):  # it may have been deleted meanwhile
                    append(session, run_id, event)


def append(session: Session, run_id: str, event: RunEvent) -> bool:
    """`append_event` inside a transaction."""
    mine = EventRow.run_id == run_id
    if session.scalar(select(EventRow.seq).where(mine, EventRow.key == event.key)) is not None:
        return False
    row = _row(session, run_id)
    last = session.scalar(select(func.max(EventRow.seq)).where(mine)) or 0
    session.add(
        EventRow(
            run_id=run_id,
            seq=last + 1,
            key=event.key,
            type=event.type,
            body=event.model_dump_json(),
            created_at=_now(),
        )
    )
    row.state = next_state(_state(row), event)
    if isinstance(event, RunFailed):
        row.error_code, row.error_message = event.code, event.message
    elif row.state != "failed":
        row.error_code, row.error_message = None, None
    row.updated_at = _now()
    if row.state in FINISHED:
        withdraw_tasks(session, run_id)
    return True


def append_all(session: Session, run_id: str, events: Sequence[RunEvent]) -> None:
    """`append` for many; those that were written before cost nothing."""
    mine = select(EventRow.key).where(EventRow.run_id == run_id)
    known: set[str] = set()
    for first in range(0, len(events), CHUNK):
        keys = [event.key for event in events[first : first + CHUNK]]
        known |= set(session.scalars(mine.where(EventRow.key.in_(keys))))
    for event in events:
        if event.key not in known:
            append(session, run_id, event)


def events_of(
    database: Database,
    run_id: str,
    *,
    after: int = 0,
    limit: int | None = None,
    type: str | None = None,
) -> list[EventRecord]:
    """Events of a run with `seq` above `after`, in order."""
    query = select(EventRow).where(EventRow.run_id == run_id, EventRow.seq > after)
    if type is not None:
        query = query.where(EventRow.type == type)
    with database.read() as session:
        _row(session, run_id)
        rows = session.scalars(query.order_by(EventRow.seq).limit(limit))
        return [EventRecord(r.seq, r.created_at, event_from_json(r.body)) for r in rows]


def request_cancel(database: Database, run_id: str) -> RunRecord:
    """Ask a run to stop. Asking again changes nothing."""
    with database.write("request_cancel") as session:
        row = _row(session, run_id)
        if row.state in {"succeeded", "failed"}:
            raise NotPossible(f"run {run_id} has {row.state}; only a live run can be cancelled")
        row.cancel_requested = True
        return _record(row)


def request_cancel_all(database: Database, benchmark_id: str) -> list[RunRecord]:
    """Ask all live runs of a benchmark to stop; these runs."""
    get_benchmark(database, benchmark_id)
    mine = (RunRow.benchmark_id == benchmark_id, RunRow.state.not_in(FINISHED))
    with database.write("request_cancel_all") as session:
        session.execute(update(RunRow).where(*mine).values(cancel_requested=True))
        return [_record(row) for row in session.scalars(select(RunRow).where(*mine))]


def resubmit(database: Database, run_id: str, accept: Accept | None = None) -> RunRecord:
    """Queue a failed or cancelled run again; its finished stages answer at once.

    Raises what `accept` raises.
    """
    with database.write("resubmit") as session:
        row = _row(session, run_id)
        if row.state not in _RESUMABLE:
            raise NotPossible(
                f"run {run_id} is {row.state}; only a failed or cancelled run can be resumed"
            )
        _queue_again(session, row)
        _check(session, accept)
        return _record(row)


def resubmit_all(
    database: Database, benchmark_id: str, accept: Accept | None = None
) -> Iterator[RunRecord]:
    """`resubmit` for all runs of a benchmark that failed or were cancelled; yields these runs.

    A batch is a transaction; what `accept` raises ends it, and earlier batches stay queued.
    """
    stopped = [run.id for run in runs_of(database, benchmark_id) if run.state in _RESUMABLE]
    for batch in batches(stopped):
        with database.write("resubmit_all") as session:
            rows = [_row(session, run_id) for run_id in batch]
            mine = [row for row in rows if row.state in _RESUMABLE]  # another may have been faster
            for row in mine:
                _queue_again(session, row)
            _check(session, accept)
            queued = [_record(row) for row in mine]
        yield from queued


def _queue_again(session: Session, row: RunRow) -> None:
    row.submission += 1
    row.cancel_requested = False
    append(session, row.id, RunQueued(submission=row.submission))


def batches(items: Sequence[T]) -> Iterator[Sequence[T]]:
    """Parts short enough that others can write between their transactions."""
    return (items[first : first + _AT_ONCE] for first in range(0, len(items), _AT_ONCE))


def delete_run(database: Database, run_id: str) -> None:
    """Delete a finished run, and the stages and artifacts that no other run refers to."""
    with database.write("delete_run") as session:
        row = _row(session, run_id)
        if row.state not in FINISHED:
            raise NotPossible(f"run {run_id} is {row.state}; cancel it before deleting it")
        if row.benchmark_id is not None:
            raise NotPossible(
                f"run {run_id} is part of benchmark {row.benchmark_id}, whose table needs it; "
                "delete the benchmark"
            )
        session.execute(delete(RunRow).where(RunRow.id == run_id))
        session.execute(delete(ResultsRow).where(ResultsRow.id == run_id))
        delete_unreferenced(session)


def delete_benchmark(database: Database, benchmark_id: str) -> None:
    """Delete a finished benchmark with its runs and what only they refer to."""
    with database.write("delete_benchmark") as session:
        row = session.scalar(select(BenchmarkRow).where(BenchmarkRow.id == benchmark_id))
        if row is None:
            raise NotFound("benchmark", benchmark_id)
        mine = RunRow.benchmark_id == benchmark_id
        if session.scalar(select(RunRow.id).where(mine, RunRow.state.not_in(FINISHED)).limit(1)):
            raise NotPossible(f"benchmark {benchmark_id} is not finished; cancel it first")
        of_runs = select(RunRow.id).where(mine).scalar_subquery()
        both = (ResultsRow.id == benchmark_id) | ResultsRow.id.in_(of_runs)
        session.execute(delete(ResultsRow).where(both))
        session.execute(delete(RunRow).where(mine))
        session.delete(row)
        session.flush()
        delete_unreferenced(session)


Deletion = tuple[Callable[[Database, str], None], str]  # what deletes, and the id


def finished_before(database: Database, moment: datetime) -> list[Deletion]:
    """Benchmarks and single runs of which nothing has changed since, with what deletes them."""
    is_recent = RunRow.state.not_in(FINISHED) | (RunRow.updated_at >= moment)
    of_it = RunRow.benchmark_id == BenchmarkRow.id
    has_recent = select(RunRow.id).where(of_it, is_recent).exists()
    single = select(RunRow.id).where(RunRow.benchmark_id.is_(None), ~is_recent)
    with database.read() as session:
        benchmarks = session.scalars(select(BenchmarkRow.id).where(~has_recent)).all()
        return [
            *((delete_benchmark, id) for id in benchmarks),
            *((delete_run, id) for id in session.scalars(single)),
        ]


def count_iterations(database: Database, run_ids: Sequence[str]) -> list[tuple[str, int]]:
    """(run id, number of iterations that it has finished), in the order of `run_ids`."""
    found = dict.fromkeys(run_ids, 0)
    finished = EventRow.type == "iteration_finished"
    with database.read() as session:
        for first in range(0, len(run_ids), CHUNK):
            mine = EventRow.run_id.in_(run_ids[first : first + CHUNK])
            query = select(EventRow.run_id, func.count()).where(mine, finished)
            found |= dict(session.execute(query.group_by(EventRow.run_id)).tuples().all())
    return list(found.items())


def kept_results(database: Database, id: str, version: str) -> str | None:
    """The result table of a run or a benchmark, if it was computed from this version."""
    with database.read() as session:
        row = session.get(ResultsRow, id)
        return row.body if row is not None and row.version == version else None


def keep_results(database: Database, id: str, version: str, body: str) -> None:
    """Keep a result table in the place of the one before."""
    with database.write("keep_results") as session:
        session.merge(ResultsRow(id=id, version=version, body=body))


def exists(session: Session, run_id: str) -> bool:
    return session.scalar(select(RunRow.id).where(RunRow.id == run_id)) is not None


def extend_benchmark(
    database: Database,
    benchmark_id: str,
    extension: BenchmarkExtension,
    accept: Accept | None = None,
) -> list[RunRecord]:
    """Add runs to a benchmark, and return them; what it has already stays as it is."""
    now = get_benchmark(database, benchmark_id)
    spec = now.spec.extended(extension)
    new = _missing(spec, runs_of(database, benchmark_id), benchmark_id)  # before the lock
    with database.write("extend_benchmark") as session:
        row = session.scalar(select(BenchmarkRow).where(BenchmarkRow.id == benchmark_id))
        if row is None:
            raise NotFound("benchmark", benchmark_id)
        if _benchmark_spec(row.spec) != now.spec:
            raise NotPossible(f"{benchmark_id} was extended by another request just now; try again")
        row.spec = spec.model_dump_json(exclude_unset=True)
        added = set(_insert_runs(session, new))
        _check(session, accept)
    return [run for run in runs_of(database, benchmark_id) if run.id in added]


def _missing(
    spec: BenchmarkSpec, present: Sequence[RunRecord], benchmark_id: str
) -> list[dict[str, Any]]:
    """The runs that a wider benchmark has and `present` lacks; NotPossible where others differ."""
    known = {_cell(run.spec): run.spec for run in present if isinstance(run.spec, RunSpec)}
    new: list[dict[str, Any]] = []
    for run in spec.runs():
        before = known.get(_cell(run))
        if before is None:
            new.append(_new_run(run, benchmark_id))
        elif before != run:
            differ = [name for name, value in run if value != getattr(before, name)]
            raise NotPossible(
                f"the runs of {benchmark_id} would differ from those it has in "
                f"{', '.join(differ)}, and would not compare with them: either the preset "
                f"{run.preset!r} has changed since, or the SimOpt that others learn from"
            )
    return new


def _cell(spec: RunSpec) -> tuple[str, str, str, int]:
    """What tells the runs of a benchmark apart."""
    return (spec.task, spec.variant, spec.column, spec.seed)


def _new_run(spec: AnyRun, benchmark_id: str | None) -> dict[str, Any]:
    """The columns of a run that was not stored yet."""
    return {
        "id": _new_id("run"),
        "benchmark_id": benchmark_id,
        "dataset_id": spec.dataset,
        "created_at": _now(),
        "updated_at": _now(),
        "task": spec.task,
        "variant": spec.variant,
        "method": spec.label,
        "seed": spec.seed,
        "spec": spec.model_dump_json(),
        "state": "queued",
        "submission": 1,
        "cancel_requested": False,
    }


def _insert_runs(session: Session, rows: Sequence[dict[str, Any]]) -> list[str]:
    """Store runs with their first event, all by two statements; their ids."""
    for dataset in {row["dataset_id"] for row in rows} - {None}:
        get_dataset(session, dataset)
    queued = RunQueued(submission=1)
    event = {"seq": 1, "key": queued.key, "type": queued.type, "body": queued.model_dump_json()}
    ids = [str(row["id"]) for row in rows]
    if rows:
        session.execute(insert(RunRow), rows)
        session.execute(
            insert(EventRow), [{**event, "run_id": id, "created_at": _now()} for id in ids]
        )
    return ids


def _row(session: Session, run_id: str) -> RunRow:
    row = session.scalar(select(RunRow).where(RunRow.id == run_id))
    if row is None:
        raise NotFound("run", run_id)
    return row


def _record(row: RunRow) -> RunRecord:
    return RunRecord(
        row.number,
        row.id,
        row.benchmark_id,
        row.created_at,
        row.updated_at,
        _run_spec(row.spec),
        _state(row),
        row.submission,
        row.cancel_requested,
        row.error_code,
        row.error_message,
    )


def _benchmark(row: BenchmarkRow) -> BenchmarkRecord:
    return BenchmarkRecord(row.number, row.id, row.created_at, _benchmark_spec(row.spec))


def _state(row: RunRow) -> RunState:
    return row.state  # type: ignore[return-value]  # the CHECK constraint holds these values


def _new_id(prefix: str) -> str:
    return f"{prefix}_{secrets.token_hex(8)}"


def _now() -> datetime:
    return datetime.now(UTC)


def states_of(database: Database, benchmark_ids: Sequence[str]) -> dict[str, dict[str, int]]:
    """By benchmark, how many of its runs are in each state."""
    found: dict[str, dict[str, int]] = {id: {} for id in benchmark_ids}
    mine = RunRow.benchmark_id.in_(benchmark_ids)
    query = select(RunRow.benchmark_id, RunRow.state, func.count(), func.min(RunRow.number))
    grouped = query.where(mine).group_by(RunRow.benchmark_id, RunRow.state)
    with database.read() as session:
        for id, state, count, _ in session.execute(grouped.order_by(func.min(RunRow.number))):
            found[str(id)][state] = count
    return found


def iterations_of(
    database: Database, run_ids: Sequence[str]
) -> list[tuple[str, IterationFinished]]:
    """(run id, event) of all iterations of the runs, in the order of `run_ids`."""
    found: dict[str, list[IterationFinished]] = {id: [] for id in run_ids}
    finished = EventRow.type == "iteration_finished"
    with database.read() as session:
        for first in range(0, len(run_ids), CHUNK):
            mine = EventRow.run_id.in_(run_ids[first : first + CHUNK])
            query = select(EventRow.run_id, EventRow.body).where(mine, finished)
            for run_id, body in session.execute(query.order_by(EventRow.seq)):
                found[run_id].append(IterationFinished.model_validate_json(body))
    return [(run_id, event) for run_id, events in found.items() for event in events]

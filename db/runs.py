"""Runs: submitted, listed, cancelled, resumed, deleted; one function per transaction.

run = create_run(database, spec)          # queued; when this returns it is on disk
request_cancel(database, run.id)          # a flag, which the run's thread reads
resubmit(database, run.id)                # its finished stages answer at once
"""

import json
import secrets
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import delete, func, insert, select
from sqlalchemy.orm import Session

from adr_service.events import FINISHED, IterationFinished, RunQueued, RunStarted, RunState, type_of
from adr_service.specs import MAX_RUNS, AnyRun, LostRun
from adr_service.specs.lost import reason_of
from db.errors import DatabaseDamaged, NotPossible
from db.events import append
from db.models import DatasetRow, EventRow, RunRow, find_row, get_row
from db.references import delete_unreferenced
from db.requests import RequestKey, once
from db.results import delete_results
from db.session import Database, parts
from db.stages import check_versions

T = TypeVar("T")
_LONG = 100_000  # characters of a spec that is read again each time
_AT_ONCE = 100  # runs that one transaction changes
_ANY_RUN: TypeAdapter[AnyRun] = TypeAdapter(AnyRun)
Accept = Callable[[int], None]  # raises if this number of unfinished runs is too large


@dataclass(frozen=True)
class RunRecord:
    """A submitted run."""

    number: int  # order of submission
    id: str
    benchmark_id: str | None  # None: it was submitted by itself
    created_at: datetime
    updated_at: datetime  # when its last event was written
    spec: AnyRun | LostRun
    state: RunState
    submission: int  # how often it was submitted: 1 + resumes
    cancel_requested: bool  # it stops at its next stage
    error_code: str | None  # of a failed run
    error_message: str | None

    @property
    def is_finished(self) -> bool:
        """True if nothing more happens to the run unless a user resumes it."""
        return self.state.is_finished


def create_run(
    database: Database,
    spec: AnyRun,
    key: RequestKey | None = None,
    accept: Accept | None = None,
) -> RunRecord:
    """Store a run, queued; when this returns it is on disk.

    Raises NotFound if the spec names a dataset that is not there, Replayed if `key` has created
    a run before, and what `accept` raises.
    """
    with database.write("create_run") as session:
        (id,) = insert_runs(session, [new_run(spec, None)])
        once(session, key, id)
        check_live(session, accept)
        return record_of(get_row(session, RunRow, id))


def get_run(database: Database, run_id: str) -> RunRecord:
    """The run with this id. Raises NotFound."""
    with database.read() as session:
        return record_of(get_row(session, RunRow, run_id))


def list_runs(
    database: Database,
    *,
    state: str | None = None,
    method: str | None = None,
    task: str | None = None,
    benchmark_id: str | None = None,
    after: int = 0,
    limit: int | None = 100,
    newest_first: bool = False,
) -> list[RunRecord]:
    """Runs in order of submission, or the newest first; those numbered above `after`."""
    order = RunRow.number.desc() if newest_first else RunRow.number
    query = select(RunRow).where(RunRow.number > after).order_by(order).limit(limit)
    filters = {"state": state, "method": method, "task": task, "benchmark_id": benchmark_id}
    for column, value in filters.items():
        if value is not None:
            query = query.where(getattr(RunRow, column) == value)
    with database.read() as session:
        return [record_of(row) for row in session.scalars(query)]


def finished_iterations(
    database: Database, tasks: Sequence[str], methods: Sequence[str]
) -> dict[str, int]:
    """Numbers of finished iterations by run, of those runs of these tasks and methods with any."""
    query = (
        select(RunRow.id, func.count())
        .join(EventRow, EventRow.run_id == RunRow.id)
        .where(RunRow.task.in_(tasks), RunRow.method.in_(methods))
        .where(EventRow.type == type_of(IterationFinished))
        .group_by(RunRow.id)
    )
    with database.read() as session:
        return dict(session.execute(query).all())


def unfinished_runs(database: Database, known: Collection[tuple[str, int]] = ()) -> list[RunRecord]:
    """Runs that are queued or running, in order of submission, without `known` (id, submission)."""
    query = select(RunRow).where(RunRow.state.not_in(FINISHED)).order_by(RunRow.number)
    with database.read() as session:
        rows = session.scalars(query)
        return [record_of(row) for row in rows if (row.id, row.submission) not in known]


def has_ended(session: Session, run_id: str) -> bool:
    """True if the run has ended, or was deleted; inside a transaction."""
    row = find_row(session, RunRow, run_id)
    return row is None or row.state in FINISHED


def begin(database: Database, record: RunRecord) -> RunRecord | None:
    """Note that a submission of a run has begun, unless it had begun before; the run as it is.

    None if the run has ended since it was read, or was submitted again. Raises NotFound.
    """
    started = RunStarted(submission=record.submission)
    with database.write(started.type) as session:
        row = get_row(session, RunRow, record.id)
        if RunState(row.state).is_finished or row.submission != record.submission:
            return None
        append(session, record.id, started)
        return record_of(row)


def request_cancel(database: Database, run_id: str) -> RunRecord:
    """Ask a run to stop; asking again changes nothing.

    Raises NotFound, and NotPossible if the run succeeded or failed.
    """
    with database.write("request_cancel") as session:
        row = get_row(session, RunRow, run_id)
        if row.state in {RunState.SUCCEEDED, RunState.FAILED}:
            raise NotPossible(f"run {run_id} has {row.state}; only a live run can be cancelled")
        row.cancel_requested = True
        return record_of(row)


def resubmit(database: Database, run_id: str, accept: Accept | None = None) -> RunRecord:
    """Queue a failed or cancelled run again; its finished stages answer at once.

    Raises NotFound, NotPossible for a run in another state, InvalidInput if a package or a kind of
    stage has another version since (in any run of its benchmark), and what `accept` raises.
    """
    with database.read() as session:
        benchmark_id = get_row(session, RunRow, run_id).benchmark_id
        together = select(RunRow.id).where(RunRow.benchmark_id == benchmark_id)
        run_ids = [run_id] if benchmark_id is None else list(session.scalars(together))
    check_versions(database, benchmark_id or run_id, run_ids)
    with database.write("resubmit") as session:
        row = get_row(session, RunRow, run_id)
        if not RunState(row.state).is_resumable:
            raise NotPossible(
                f"run {run_id} is {row.state}; only a failed or cancelled run can be resumed"
            )
        queue_again(session, row)
        check_live(session, accept)
        return record_of(row)


def delete_run(database: Database, run_id: str, since: datetime | None = None) -> None:
    """Delete a finished run, and the stages and artifacts that no other run refers to.

    Raises NotFound, and NotPossible for a live run, one of a benchmark, or one that has changed
    after `since`.
    """
    with database.write("delete_run") as session:
        row = get_row(session, RunRow, run_id)
        if not RunState(row.state).is_finished:
            raise NotPossible(f"run {run_id} is {row.state}; cancel it before deleting it")
        if row.benchmark_id is not None:
            raise NotPossible(
                f"run {run_id} is part of benchmark {row.benchmark_id}, whose table needs it; "
                "delete the benchmark"
            )
        if since is not None and row.updated_at >= since:
            raise NotPossible(f"run {run_id} has changed meanwhile")
        session.execute(delete(RunRow).where(RunRow.id == run_id))
        delete_results(session, [run_id])
        delete_unreferenced(session)


def batches(items: Sequence[T]) -> Iterator[Sequence[T]]:
    """Parts of a sequence so short that others can write between their transactions."""
    return parts(items, _AT_ONCE)


def new_run(spec: AnyRun, benchmark_id: str | None) -> dict[str, Any]:
    """The columns of a run that is not stored yet."""
    now = datetime.now(UTC)
    return {
        "id": new_id("run"),
        "benchmark_id": benchmark_id,
        "dataset_id": spec.dataset,
        "created_at": now,
        "updated_at": now,
        "task": spec.task,
        "variant": spec.variant,
        "method": spec.label,
        "seed": spec.seed,
        "spec": spec.model_dump_json(),
        "state": RunState.QUEUED.value,
        "submission": 1,
        "cancel_requested": False,
    }


def insert_runs(session: Session, rows: Sequence[dict[str, Any]]) -> list[str]:
    """Store runs with their first event by two statements, inside a transaction; their ids.

    Raises NotFound if one names a dataset that is not there.
    """
    for dataset in {row["dataset_id"] for row in rows} - {None}:
        get_row(session, DatasetRow, dataset)
    queued, now = RunQueued(submission=1), datetime.now(UTC)
    event = {"seq": 1, "key": queued.key, "type": queued.type, "body": queued.model_dump_json()}
    ids = [str(row["id"]) for row in rows]
    if rows:
        session.execute(insert(RunRow), rows)
        session.execute(
            insert(EventRow), [{**event, "run_id": id, "created_at": now} for id in ids]
        )
    return ids


def queue_again(session: Session, row: RunRow) -> None:
    """Submit a run once more, inside a transaction."""
    row.submission += 1
    row.cancel_requested = False
    append(session, row.id, RunQueued(submission=row.submission))


def check_live(session: Session, accept: Accept | None) -> None:
    """Call `accept` with the number of unfinished runs; what it raises undoes the transaction."""
    if accept is not None:
        live = RunRow.state.not_in(FINISHED)
        accept(session.scalar(select(func.count()).select_from(RunRow).where(live)) or 0)


def record_of(row: RunRow) -> RunRecord:
    """The value of a row."""
    return RunRecord(
        row.number,
        row.id,
        row.benchmark_id,
        row.created_at,
        row.updated_at,
        _spec_of(row),
        RunState(row.state),
        row.submission,
        row.cancel_requested,
        row.error_code,
        row.error_message,
    )


def new_id(prefix: str) -> str:
    """A random id that nobody can guess, as `run_9c5e3c4a0b8f3d21`."""
    return f"{prefix}_{secrets.token_hex(8)}"


def document_of(text: str, kind: str) -> dict[str, Any]:
    """The JSON object of a stored spec; raises DatabaseDamaged if that is none."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise DatabaseDamaged(
            f"the database is damaged: a stored {kind} is no JSON object; `adr db check` says where"
        )
    return cast(dict[str, Any], document)


def _read(text: str) -> AnyRun | str:
    """The spec, or the reason why it cannot be read any more."""
    try:
        return _ANY_RUN.validate_json(text)
    except ValidationError as error:
        return reason_of(document_of(text, "run"), error)


# parsing costs more than reading, and specs never change
_kept = lru_cache(maxsize=2 * MAX_RUNS)(_read)


def _spec_of(row: RunRow) -> AnyRun | LostRun:
    """The spec of a row, or what is known of it."""
    spec = _kept(row.spec) if len(row.spec) < _LONG else _read(row.spec)
    if not isinstance(spec, str):
        return spec
    own = {name: getattr(row, name) for name in ("task", "variant", "method", "seed")}
    return LostRun(**own, dataset=row.dataset_id, reason=spec)

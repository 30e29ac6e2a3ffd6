"""Events of runs, each written once; a run's state is the fold of its events.

append_event(database, run_id, RunStarted(submission=1))     # False: it was not new
events_of(database, run_id, after=3)
"""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import TypeVar

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from adr_service.benchmark.replay import repeats
from adr_service.errors import InvalidInput
from adr_service.events import (
    CriticismFinished,
    IterationFinished,
    RunEvent,
    RunFailed,
    RunState,
    RunStopped,
    TrainingEvaluated,
    event_from_json,
    next_state,
    type_of,
)
from adr_service.json_values import Wire
from db import visits
from db.models import EventRow, RunRow, find_row, get_row
from db.session import CHUNK, Database, parts

E = TypeVar("E", IterationFinished, CriticismFinished, TrainingEvaluated)
_ITERATION = EventRow.type == type_of(IterationFinished)


class EventRecord(Wire):
    """An event of a run, as it was written."""

    seq: int  # 1, 2, … within the run
    created_at: datetime
    event: RunEvent


def append_event(database: Database, run_id: str, event: RunEvent) -> bool:
    """Write an event and the state it leads to.

    False if its key was written before, or if it ends an earlier submission, whose thread was slow
    to see that the run had ended and was submitted again. Raises NotFound if there is no such run.
    """
    with database.write(event.type) as session:
        return append(session, run_id, event)


def append_events(database: Database, events: Sequence[tuple[str, RunEvent]]) -> None:
    """Write (run id, event) pairs in one transaction; runs that were deleted are skipped."""
    if events:
        with database.write("append_events") as session:
            for run_id, event in events:
                append_to_all(session, [run_id], [event])


def append(session: Session, run_id: str, event: RunEvent) -> bool:
    """`append_event` inside a transaction."""
    return _append_new(session, get_row(session, RunRow, run_id), [event]) > 0


def append_to_all(session: Session, run_ids: Sequence[str], events: Sequence[RunEvent]) -> None:
    """Write events to several runs, inside a transaction; runs that were deleted are skipped."""
    for run_id in run_ids:
        row = find_row(session, RunRow, run_id)
        if row is not None:
            _append_new(session, row, events)


def end(session: Session, run_id: str, event: Callable[[int], RunEvent]) -> None:
    """Write the event that ends a run's present submission; inside a transaction.

    A run that was deleted, has ended, or was asked to stop is left as it is.
    """
    if visits.is_wanted(session, run_id):
        row = get_row(session, RunRow, run_id)
        _append_new(session, row, [event(row.submission)])


def events_of(
    database: Database, run_id: str, *, after: int = 0, limit: int | None = None
) -> list[EventRecord]:
    """Events of a run with `seq` above `after`, in order. Raises NotFound without the run."""
    query = select(EventRow).where(EventRow.run_id == run_id, EventRow.seq > after)
    with database.read() as session:
        get_row(session, RunRow, run_id)
        rows = session.scalars(query.order_by(EventRow.seq).limit(limit))
        return [
            EventRecord(seq=r.seq, created_at=r.created_at, event=event_from_json(r.body))
            for r in rows
        ]


def count_iterations(database: Database, run_ids: Sequence[str]) -> list[tuple[str, int]]:
    """Pairs (run id, number of iterations that it has finished), in the order of `run_ids`."""
    counts = dict.fromkeys(run_ids, 0)
    query = select(EventRow.run_id, func.count()).where(_ITERATION).group_by(EventRow.run_id)
    with database.read() as session:
        for chunk in parts(run_ids, CHUNK):
            rows = session.execute(query.where(EventRow.run_id.in_(chunk)))
            counts |= dict(rows.all())
    return list(counts.items())


def all_of(database: Database, run_ids: Sequence[str], kind: type[E]) -> list[tuple[str, E]]:
    """Pairs (run id, event) of all events of a kind, in the order of `run_ids`."""
    events: dict[str, list[E]] = {id: [] for id in run_ids}
    mine = EventRow.type == type_of(kind)
    query = select(EventRow.run_id, EventRow.body).where(mine).order_by(EventRow.seq)
    with database.read() as session:
        for chunk in parts(run_ids, CHUNK):
            for run_id, body in session.execute(query.where(EventRow.run_id.in_(chunk))):
                events[run_id].append(kind.model_validate_json(body))
    return [(run_id, event) for run_id, own in events.items() for event in own]


def _append_new(session: Session, row: RunRow, events: Sequence[RunEvent]) -> int:
    """Write those events that a run does not have yet; their number.

    What the run has is looked up once for all of them. Raises InvalidInput for an iteration that
    came out otherwise before.
    """
    known = _known_keys(session, row.id, [event.key for event in events])
    for event in events:
        if isinstance(event, IterationFinished) and event.key in known:
            _check_again(session, row.id, event)
    new = {
        event.key: event for event in events if event.key not in known and not _is_late(row, event)
    }
    if new:
        numbers = select(func.max(EventRow.seq)).where(EventRow.run_id == row.id)
        last, now = session.scalar(numbers) or 0, datetime.now(UTC)
        for seq, (key, event) in enumerate(new.items(), last + 1):
            body = {"type": event.type, "body": event.model_dump_json()}
            session.add(EventRow(run_id=row.id, seq=seq, key=key, created_at=now, **body))
            _advance(session, row, event)
    return len(new)


def _is_late(row: RunRow, event: RunEvent) -> bool:
    return isinstance(event, RunFailed | RunStopped) and event.submission < row.submission


def _check_again(session: Session, run_id: str, event: IterationFinished) -> None:
    """Refuse another answer of an iteration that a run has: later ones would not belong to it."""
    mine = select(EventRow.body).where(EventRow.run_id == run_id, EventRow.key == event.key)
    before = IterationFinished.model_validate_json(session.scalars(mine).one())
    if not repeats(event, before):
        raise InvalidInput(
            f"iteration {event.iteration} came out otherwise than before: a method, a task or the "
            "service has changed since; submit a new run"
        )


def _advance(session: Session, row: RunRow, event: RunEvent) -> None:
    """Bring a run's state and error up to an event; a run that ends withdraws its visits."""
    state = next_state(RunState(row.state), event)
    row.state, row.updated_at = state, datetime.now(UTC)
    if isinstance(event, RunFailed):
        row.error_code, row.error_message = event.code, event.message
    elif state != RunState.FAILED:
        row.error_code, row.error_message = None, None
    if state.is_finished:
        visits.withdraw(session, row.id)


def _known_keys(session: Session, run_id: str, keys: Sequence[str]) -> set[str]:
    """Those of `keys` that the run has an event with."""
    mine, known = select(EventRow.key).where(EventRow.run_id == run_id), set[str]()
    for chunk in parts(keys, CHUNK):
        known |= set(session.scalars(mine.where(EventRow.key.in_(chunk))))
    return known

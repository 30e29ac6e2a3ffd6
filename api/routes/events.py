"""/v1/runs/{id}/events: the events of a run, page by page or as they happen."""

from collections.abc import AsyncIterable
from typing import Annotated

import anyio
from fastapi import APIRouter, Depends, Header, Query
from fastapi.sse import EventSourceResponse, ServerSentEvent

from api.parameters import RunId
from api.routes.paging import MOST_NUMBERS, Page, PageSize, page_of
from api.routes.polling import EVERY_S
from api.service import ServiceDependency
from db import events as event_store
from db import runs as run_store
from db.errors import DatabaseUnavailable, NotFound
from db.events import EventRecord
from db.runs import RunRecord
from db.session import Database

router = APIRouter(prefix="/v1/runs", tags=["runs"])
_STREAMED = 500  # events at once


def _existing(run_id: RunId, service: ServiceDependency) -> str:
    """Refuse an unknown run before a stream begins."""
    return run_store.get_run(service.database, run_id).id


def _last_seen(
    last_event_id: Annotated[
        int, Header(ge=0, lt=MOST_NUMBERS, description="of the last event seen")
    ] = 0,
) -> int:
    return last_event_id


@router.get("/{run_id}/events")
def events(
    run_id: RunId,
    service: ServiceDependency,
    after: Annotated[
        int, Query(ge=0, lt=MOST_NUMBERS, description="only events above this number")
    ] = 0,
    limit: PageSize = 100,
) -> Page[EventRecord]:
    """Events with a sequence number above `after`."""
    records = event_store.events_of(service.database, run_id, after=after, limit=limit + 1)
    return page_of(records, limit, lambda record: record, lambda record: record.seq)


@router.get("/{run_id}/events/stream", response_class=EventSourceResponse)
async def stream(
    run_id: Annotated[str, Depends(_existing)],
    service: ServiceDependency,
    seen: Annotated[int, Depends(_last_seen)],
) -> AsyncIterable[ServerSentEvent]:
    """Events as they happen, until the run has ended; `id` is the sequence number."""
    while True:
        try:
            run, records = await anyio.to_thread.run_sync(_look, service.database, run_id, seen)
        except NotFound:
            yield ServerSentEvent(event="end", data={"state": "deleted"})
            return
        except DatabaseUnavailable:  # the answer has begun, so no 503 can say it
            await anyio.sleep(EVERY_S)
            continue
        for record in records:
            seen = record.seq
            yield ServerSentEvent(id=str(seen), event=record.event.type, data=record)
        if run.is_finished and len(records) < _STREAMED:
            yield ServerSentEvent(event="end", data={"state": run.state})
            return
        if not records:
            await anyio.sleep(EVERY_S)


def _look(database: Database, run_id: str, seen: int) -> tuple[RunRecord, list[EventRecord]]:
    """A run, and the first of its events above `seen`. Raises NotFound."""
    # its state is read first: the event that ended it is among the records then
    run = run_store.get_run(database, run_id)
    return run, event_store.events_of(database, run_id, after=seen, limit=_STREAMED)

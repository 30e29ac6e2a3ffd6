"""/v1/runs: submit, watch, stop, resume and read single runs."""

import time
from collections.abc import AsyncIterable
from functools import partial
from typing import Annotated, Any, Literal

import anyio
from adr_service.benchmark.protocol import Plan, plan
from fastapi import APIRouter, Depends, Header, Query, Response, status
from fastapi.sse import EventSourceResponse, ServerSentEvent

from adr_service.benchmark.comparison import table, to_csv
from adr_service.benchmark.figures import Format, draw, drawable
from adr_service.events import RunState
from adr_service.json_values import sha256
from adr_service.specs import AnyRun, RunSpec
from api.bodies import RunBody
from api.service import IdempotencyKey, Service, ServiceDependency, request_key
from api.views import (
    CostView,
    DistributionView,
    EventView,
    Page,
    PlannedRun,
    ResultsView,
    RunView,
    TrainingView,
    distribution_view,
    event_view,
    page_of,
    run_view,
    training_views,
)
from db import runs as store
from db import stages as stage_store
from db.errors import NotFound
from db.requests import Replayed
from db.runs import RunRecord

router = APIRouter(prefix="/v1/runs", tags=["runs"])
LOOK_EVERY_S = 0.25  # for those who wait
_STREAMED = 500  # events at once
CSV: dict[int | str, Any] = {200: {"content": {"text/csv": {"schema": {"type": "string"}}}}}
PageSize = Annotated[int, Query(ge=1, le=1000)]
MEDIA = {"svg": "image/svg+xml", "png": "image/png", "csv": "text/csv"}


def _existing(run_id: str, service: ServiceDependency) -> str:
    """Refuses a run that is not there, before a stream begins."""
    return store.get_run(service.database, run_id).id


def _last_seen(
    last_event_id: Annotated[
        str | None, Header(pattern=r"^[0-9]{1,18}$", description="of the last event seen")
    ] = None,
) -> int:
    return int(last_event_id or 0)


@router.post(
    "",
    status_code=status.HTTP_202_ACCEPTED,
    responses={200: {"model": PlannedRun, "description": "with `validate_only`"}},
)
def submit(
    spec: RunBody,
    service: ServiceDependency,
    response: Response,
    validate_only: bool = False,
    idempotency_key: IdempotencyKey = None,
) -> RunView | PlannedRun:
    """Store a run and start it; with `validate_only`, say what it would cost instead."""
    service.check_dataset(spec)
    if validate_only:
        response.status_code = status.HTTP_200_OK
        return PlannedRun(spec=spec, plan=plan_here(service, [spec]))
    record = start(service, spec, idempotency_key)
    response.headers["Location"] = f"/v1/runs/{record.id}"
    return run_view_of(service, record)


@router.get("")
def list_runs(
    service: ServiceDependency,
    state: RunState | None = None,
    method: str | None = None,
    task: str | None = None,
    benchmark_id: str | None = None,
    page_size: PageSize = 100,
    page_token: Annotated[int, Query(ge=0, lt=2**63)] = 0,
) -> Page[RunView]:
    """Runs in order of submission."""
    records = store.list_runs(
        service.database,
        state=state,
        method=method,
        task=task,
        benchmark_id=benchmark_id,
        after=page_token,
        limit=page_size + 1,
    )
    return page_of(records, page_size, partial(run_view_of, service), lambda record: record.number)


@router.get("/{run_id}")
async def get_run(
    run_id: str,
    service: ServiceDependency,
    wait: Annotated[float, Query(ge=0, le=20, description="s for its state to change")] = 0.0,
) -> RunView:
    """How it stands; with `wait`, as soon as its state is another, or has ended."""
    until = time.monotonic() + wait
    record = first = await anyio.to_thread.run_sync(store.get_run, service.database, run_id)
    while record.state == first.state and not record.is_finished and time.monotonic() < until:
        await anyio.sleep(LOOK_EVERY_S)
        record = await anyio.to_thread.run_sync(store.get_run, service.database, run_id)
    return run_view_of(service, record)


@router.post("/{run_id}/cancel", status_code=status.HTTP_202_ACCEPTED)
def cancel(run_id: str, service: ServiceDependency) -> RunView:
    """Ask a run to stop; what its stages have finished is kept."""
    record = store.request_cancel(service.database, run_id)
    service.orchestrator.cancel(record)
    return run_view_of(service, record)


@router.post("/{run_id}/resume", status_code=status.HTTP_202_ACCEPTED)
def resume(run_id: str, service: ServiceDependency) -> RunView:
    """Go on with a failed or cancelled run from its last finished stage."""
    record = store.resubmit(service.database, run_id, service.check_queue)
    service.orchestrator.submit(record)
    return run_view_of(service, record)


@router.delete("/{run_id}", status_code=status.HTTP_204_NO_CONTENT)
def delete(run_id: str, service: ServiceDependency) -> None:
    """Delete a finished run and what only it refers to."""
    store.delete_run(service.database, run_id)


@router.get("/{run_id}/events")
def events(
    run_id: str,
    service: ServiceDependency,
    after: Annotated[int, Query(ge=0, lt=2**63)] = 0,
    limit: PageSize = 100,
) -> Page[EventView]:
    """Events with a sequence number above `after`."""
    found = store.events_of(service.database, run_id, after=after, limit=limit + 1)
    return page_of(found, limit, event_view, lambda record: record.seq)


@router.get("/{run_id}/events/stream", response_class=EventSourceResponse)
async def stream(
    run_id: Annotated[str, Depends(_existing)],
    service: ServiceDependency,
    seen: Annotated[int, Depends(_last_seen)],
) -> AsyncIterable[ServerSentEvent]:
    """Its events as they happen (`id` is their sequence number), until it has ended."""
    while True:
        # its state is read first: what ended it is among the events then
        record = await anyio.to_thread.run_sync(store.get_run, service.database, run_id)
        page = partial(store.events_of, service.database, run_id, after=seen, limit=_STREAMED)
        found = await anyio.to_thread.run_sync(page)
        for event in found:
            seen = event.seq
            yield ServerSentEvent(id=str(seen), event=event.event.type, data=event_view(event))
        if record.is_finished and len(found) < _STREAMED:
            yield ServerSentEvent(event="end", data={"state": record.state})
            return
        if not found:
            await anyio.sleep(LOOK_EVERY_S)


@router.get("/{run_id}/results", response_model=ResultsView, responses=CSV)
def results(
    run_id: str, service: ServiceDependency, format: Literal["json", "csv"] = "json"
) -> Response:
    """Its result table, after every iteration; and comparisons, estimates, costs."""
    record = store.get_run(service.database, run_id)
    if format == "csv":
        return Response(to_csv(table(service.outcomes([record]))), media_type="text/csv")
    return Response(service.results(run_id, [record]), media_type="application/json")


@router.get("/{run_id}/cost")
def cost(run_id: str, service: ServiceDependency) -> CostView:
    """What its stages cost, and how busy the cores were."""
    return service.cost([store.get_run(service.database, run_id)])


@router.get("/{run_id}/trainings")
def trainings(run_id: str, service: ServiceDependency) -> list[TrainingView]:
    """The learning curves of its policies, of those in training as well."""
    return training_views(run_id, store.events_of(service.database, run_id))


@router.get("/{run_id}/trainings/{digest}/policy", response_class=Response)
def policy_of_training(run_id: str, digest: str, service: ServiceDependency) -> Response:
    """The policy of a training; the best so far, while it goes on."""
    known = training_views(run_id, store.events_of(service.database, run_id))
    content = stage_store.policy_of_training(service.database, digest)
    if content is None or digest not in {training.digest for training in known}:
        raise NotFound("policy of training", digest)
    return bytes_response(content, f"{digest[:12]}.safetensors")


@router.get("/{run_id}/figures")
def figures(run_id: str, service: ServiceDependency) -> list[str]:
    """Names of the figures that can be drawn by now."""
    return drawable(service.outcomes([store.get_run(service.database, run_id)]))


@router.get("/{run_id}/figures/{name}.{file_format}", response_class=Response)
def figure(run_id: str, name: str, file_format: Format, service: ServiceDependency) -> Response:
    """A figure, or its numbers as CSV."""
    outcomes = service.outcomes([store.get_run(service.database, run_id)])
    return Response(draw(name, outcomes, file_format), media_type=MEDIA[file_format])


@router.get("/{run_id}/distribution")
def distribution(run_id: str, service: ServiceDependency) -> DistributionView:
    """What the latest policy was trained on: the method's answer, by parameter."""
    record = store.get_run(service.database, run_id)
    outcomes = service.outcomes([record])
    if not outcomes:
        raise NotFound("finished iteration of run", run_id)
    return distribution_view(outcomes[-1])


@router.get("/{run_id}/policy", response_class=Response)
def policy(run_id: str, service: ServiceDependency) -> Response:
    """The latest evaluated policy (of several, the first), as safetensors."""
    outcomes = service.outcomes([store.get_run(service.database, run_id)])
    if not outcomes:
        raise NotFound("evaluated policy of run", run_id)
    digest = outcomes[-1].iteration.policies[0]
    return artifact_response(service, digest, f"{run_id}.safetensors")


def start(service: Service, spec: AnyRun, key: str | None) -> RunRecord:
    """Store a run and start it; where the key has started one before, that run."""
    try:
        record = store.create_run(
            service.database, spec, request_key(key, spec), service.check_queue
        )
    except Replayed as before:
        record = store.get_run(service.database, before.id)
    if not record.is_finished:
        service.orchestrator.submit(record)
    return record


def artifact_response(service: Service, digest: str, filename: str) -> Response:
    content = stage_store.artifact(service.database, digest)
    if content is None:
        raise NotFound("artifact", digest)
    return bytes_response(content, filename)


def bytes_response(content: bytes, filename: str) -> Response:
    """A file to be saved."""
    return Response(
        content,
        media_type="application/octet-stream",
        headers={
            "ETag": f'"{sha256(content)}"',
            "Content-Disposition": f'attachment; filename="{filename}"',
        },
    )


def plan_here(service: Service, specs: list[RunSpec]) -> Plan:
    return plan(specs, service.orchestrator.cores)


def run_view_of(service: Service, record: RunRecord) -> RunView:
    return run_view(record, service.orchestrator.activities(record.id))

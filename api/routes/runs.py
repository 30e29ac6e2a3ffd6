"""/v1/runs: submit, watch, stop, resume and delete single runs."""

from functools import partial
from typing import Annotated

import anyio
from fastapi import APIRouter, Query, Response, status
from pydantic import BaseModel

from adr_service.benchmark.plan import Plan
from adr_service.events import RunState
from adr_service.specs import RunSpec
from api.bodies import RunBody
from api.parameters import RunId, ValidateOnly
from api.routes.paging import Page, PageSize, PageToken, page_of
from api.routes.polling import looks
from api.routes.submissions import IdempotencyKey, plan_here, start_run
from api.service import ServiceDependency
from api.views import RunView, run_view
from db import runs as run_store

router = APIRouter(prefix="/v1/runs", tags=["runs"])


class PlannedRun(BaseModel):
    """Expected cost of a run."""

    spec: RunSpec
    plan: Plan


@router.post(
    "",
    status_code=status.HTTP_202_ACCEPTED,
    responses={200: {"model": PlannedRun, "description": "with `validate_only`"}},
)
def submit(
    spec: RunBody,
    service: ServiceDependency,
    response: Response,
    validate_only: ValidateOnly = False,
    idempotency_key: IdempotencyKey = None,
) -> RunView | PlannedRun:
    """Store a run and start it; with `validate_only`, return the expected cost."""
    service.check_dataset(spec)
    if validate_only:
        response.status_code = status.HTTP_200_OK
        return PlannedRun(spec=spec, plan=plan_here(service, [spec]))
    record = start_run(service, spec, idempotency_key)
    response.headers["Location"] = f"/v1/runs/{record.id}"
    return run_view(service, record)


@router.get("")
def list_runs(
    service: ServiceDependency,
    state: Annotated[RunState | None, Query(description="only runs in this state")] = None,
    method: Annotated[str | None, Query(description="only runs of this method")] = None,
    task: Annotated[str | None, Query(description="only runs on this task")] = None,
    benchmark_id: Annotated[str | None, Query(description="only runs of this benchmark")] = None,
    page_size: PageSize = 100,
    page_token: PageToken = 0,
) -> Page[RunView]:
    """Runs in order of submission."""
    records = run_store.list_runs(
        service.database,
        state=state,
        method=method,
        task=task,
        benchmark_id=benchmark_id,
        after=page_token,
        limit=page_size + 1,
    )
    return page_of(records, page_size, partial(run_view, service), lambda record: record.number)


@router.get("/{run_id}")
async def get_run(
    run_id: RunId,
    service: ServiceDependency,
    wait: Annotated[
        float, Query(ge=0, le=20, description="seconds to wait for another state")
    ] = 0.0,
) -> RunView:
    """State of a run; `wait` delays the answer until the state changes or the run ends."""
    record = first = await anyio.to_thread.run_sync(run_store.get_run, service.database, run_id)
    async for look in looks(wait):
        if look:
            record = await anyio.to_thread.run_sync(run_store.get_run, service.database, run_id)
        if record.state != first.state or record.is_finished:
            break
    return run_view(service, record)


@router.post("/{run_id}/cancel", status_code=status.HTTP_202_ACCEPTED)
def cancel(run_id: RunId, service: ServiceDependency) -> RunView:
    """Ask a run to stop; the results of finished stages stay."""
    record = run_store.request_cancel(service.database, run_id)
    service.orchestrator.cancel(record)
    return run_view(service, record)


@router.post("/{run_id}/resume", status_code=status.HTTP_202_ACCEPTED)
def resume(run_id: RunId, service: ServiceDependency) -> RunView:
    """Continue a failed or cancelled run from its last finished stage."""
    record = run_store.resubmit(service.database, run_id, service.check_queue)
    service.orchestrator.submit(record)
    return run_view(service, record)


@router.delete("/{run_id}", status_code=status.HTTP_204_NO_CONTENT)
def delete(run_id: RunId, service: ServiceDependency) -> None:
    """Delete a finished run and everything that only it refers to."""
    run_store.delete_run(service.database, run_id)

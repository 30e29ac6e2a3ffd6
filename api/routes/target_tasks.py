"""/v1/target_tasks: episodes that runs with a target outside wait for (docs/robots.md).

A robot's client claims one, says that it goes on, and uploads what happened. What it says carries
the lease of its claim; once that is lost, everything is refused with 409 and the robot stops.
"""

import time
from functools import partial
from typing import Annotated

import anyio
from fastapi import APIRouter, Body, Depends, Header, Query, Request, Response, status
from pydantic import Field

from adr_service.json_values import Line, Paragraphs, Wire
from api.routes.datasets import LARGEST, NPZ, octets
from api.routes.runs import LOOK_EVERY_S, PageSize, bytes_response
from api.service import ServiceDependency
from api.views import ClaimView, HeartbeatView, Page, TaskView, claim_view, page_of, task_view
from db import visits as store
from db.models import VisitState

router = APIRouter(prefix="/v1/target_tasks", tags=["target tasks"])
_Name = Annotated[Line, Field(min_length=1, max_length=80)]
_Lease = Annotated[str, Field(min_length=1, max_length=64)]


class Claim(Wire):
    """Who asks for work, and for which robots."""

    worker: _Name
    tasks: list[_Name] = Field(min_length=1, max_length=100)
    wait_s: float = Field(0.0, ge=0, le=20, description="for a task, where there is none")


class Heartbeat(Wire):
    lease: _Lease
    steps: int = Field(ge=0, lt=2**31, description="of the episode so far")


class Release(Wire):
    lease: _Lease


class Failure(Wire):
    lease: _Lease
    message: Paragraphs = Field(min_length=1, max_length=2000, description="why nobody can do this")


@router.post("/claim", response_model=ClaimView, responses={204: {"description": "no task"}})
async def claim(
    body: Annotated[Claim, Body(examples=[{"worker": "robot-7", "tasks": ["arm"]}])],
    service: ServiceDependency,
    request: Request,
) -> ClaimView | Response:
    """The oldest task that nobody has; waits for one for a while."""
    until = time.monotonic() + body.wait_s
    while not await request.is_disconnected():
        found = await anyio.to_thread.run_sync(service.claim, body.worker, body.tasks)
        if found is not None and not await request.is_disconnected():
            return claim_view(found)
        if found is not None and found.lease is not None:  # for somebody who is there
            release = partial(store.release, service.database, found.id, found.lease)
            await anyio.to_thread.run_sync(release)
        if time.monotonic() >= until:
            break
        await anyio.sleep(LOOK_EVERY_S)
    return Response(status_code=status.HTTP_204_NO_CONTENT)


@router.get("")
def list_tasks(
    service: ServiceDependency,
    state: VisitState | None = None,
    run_id: str | None = None,
    external: Annotated[bool | None, Query(description="for robots, not simulated")] = None,
    page_size: PageSize = 100,
    page_token: Annotated[int, Query(ge=0, lt=2**63)] = 0,
) -> Page[TaskView]:
    """Visits to targets, in order."""
    found = store.list_visits(
        service.database,
        state=state,
        run_id=run_id,
        external=external,
        after=page_token,
        limit=page_size + 1,
    )
    return page_of(found, page_size, task_view, lambda record: record.number)


@router.get("/{task_id}")
def get_task(task_id: str, service: ServiceDependency) -> TaskView:
    """Who has it, since when, and how far it is."""
    return task_view(store.get_visit(service.database, task_id))


@router.get("/{task_id}/policy", response_class=Response)
def policy(task_id: str, service: ServiceDependency) -> Response:
    """Whose actions are asked for, as safetensors; 404 where random ones are."""
    return bytes_response(store.policy_of(service.database, task_id), f"{task_id}.safetensors")


@router.post("/{task_id}/heartbeat")
def heartbeat(
    task_id: str, body: Annotated[Heartbeat, Body()], service: ServiceDependency
) -> HeartbeatView:
    """The episode goes on; the answer says until when, and whether to stop."""
    now, lease_s = service.orchestrator.clock.now(), service.settings.lease_s
    task = store.heartbeat(service.database, task_id, body.lease, body.steps, now, lease_s)
    assert task.expires_at is not None
    return HeartbeatView(lease_expires_at=task.expires_at, cancel_requested=task.is_unwanted)


@router.put("/{task_id}/trajectory", max_body_size=LARGEST, dependencies=[Depends(octets)])
def upload(
    task_id: str,
    content: Annotated[bytes, Body(media_type=NPZ)],
    lease: Annotated[_Lease, Header()],
    service: ServiceDependency,
) -> TaskView:
    """What happened, an `.npz` as of a recording with `rewards`; accepted once."""
    return task_view(service.orchestrator.complete_task(task_id, lease, content))


@router.post("/{task_id}/release")
def release(task_id: str, body: Annotated[Release, Body()], service: ServiceDependency) -> TaskView:
    """Give the task back, for another robot or another time."""
    return task_view(store.release(service.database, task_id, body.lease))


@router.post("/{task_id}/fail")
def fail(task_id: str, body: Annotated[Failure, Body()], service: ServiceDependency) -> TaskView:
    """No robot can do this; its run fails with the message, and can be resumed."""
    return task_view(service.orchestrator.fail_task(task_id, body.lease, body.message))

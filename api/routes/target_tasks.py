"""/v1/target_tasks: episodes on an external target that runs wait for (docs/robots.md).

A robot's client claims one, sends heartbeats, and uploads the trajectory. Each request carries the
lease of the claim. Once the lease is lost, the service refuses them with 409 and the robot stops.
"""

from datetime import datetime
from functools import partial
from typing import Annotated

import anyio
from fastapi import APIRouter, Body, Depends, Header, Query, Request, Response, status
from pydantic import BaseModel, Field

from adr_service.errors import UnknownName
from adr_service.json_values import Line, Paragraphs, Wire
from adr_service.specs.names import TaskName
from adr_service.tasks import catalogue
from api.parameters import TargetTaskId
from api.routes.downloads import bytes_response
from api.routes.paging import Page, PageSize, PageToken, page_of
from api.routes.polling import looks
from api.service import ServiceDependency
from api.uploads import LARGEST, content_described, octets
from db import visits as visit_store
from db.models import VisitState
from db.visits import Visit

router = APIRouter(prefix="/v1/target_tasks", tags=["target tasks"])
_Name = Annotated[Line, Field(min_length=1, max_length=80)]
_Lease = Annotated[str, Field(min_length=1, max_length=64)]


class TaskView(BaseModel):
    """A visit to a target: an episode that a claimant runs, has run, or may claim."""

    id: str
    run_id: str
    task: str
    kind: str  # of the episode: rollout, return, evaluation; else of the stage
    number: int
    # at most; null: an episode of a task that is not installed any more
    transitions: int | None
    seed: int
    has_policy: bool  # else random actions
    external: bool
    state: VisitState
    attempt: int
    worker: str | None
    steps: int
    claimed_at: datetime | None
    lease_expires_at: datetime | None
    error: str | None
    created_at: datetime
    links: dict[str, str]


class ClaimView(BaseModel):
    """A task for a robot, and the lease that all its later requests must carry."""

    task: TaskView
    lease: str
    lease_s: float  # from now on, or from the last heartbeat


class HeartbeatView(BaseModel):
    lease_expires_at: datetime
    cancel_requested: bool  # stop moving, and release the task


class Claim(Wire):
    """A request for work: the name of the client, and the tasks of its robots."""

    worker: _Name
    tasks: list[TaskName] = Field(min_length=1, max_length=100)
    wait_s: float = Field(
        0.0, ge=0, le=20, description="seconds to wait for a task if none is free"
    )


class Heartbeat(Wire):
    lease: _Lease
    steps: int = Field(ge=0, lt=2**31, description="steps of the episode so far")


class Release(Wire):
    lease: _Lease


class Failure(Wire):
    lease: _Lease
    message: Paragraphs = Field(
        min_length=1, max_length=2000, description="reason why no robot can do it"
    )


def task_view(task: Visit) -> TaskView:
    here, inputs = f"/v1/target_tasks/{task.id}", task.inputs
    return TaskView(
        id=task.id,
        run_id=task.run_id,
        task=task.task,
        kind=inputs.get("purpose", task.kind),
        number=inputs.get("number", inputs.get("iteration", 0)),
        transitions=_transitions(task),
        seed=inputs["seed"],
        has_policy=task.has_policy,
        external=task.external,
        state=task.state,
        attempt=task.attempt,
        worker=task.worker,
        steps=task.steps,
        claimed_at=task.claimed_at,
        lease_expires_at=task.expires_at,
        error=task.error,
        created_at=task.created_at,
        links={
            "self": here,
            "run": f"/v1/runs/{task.run_id}",
            **({"policy": f"{here}/policy"} if task.has_policy else {}),
        },
    )


def _transitions(task: Visit) -> int | None:
    asked: int | None = task.inputs.get("transitions")
    try:
        return asked or catalogue.get_task(task.task).horizon
    except UnknownName:
        return None


def claim_view(task: Visit) -> ClaimView:
    assert task.lease is not None
    assert task.expires_at is not None
    assert task.claimed_at is not None
    lease_s = (task.expires_at - task.claimed_at).total_seconds()
    return ClaimView(task=task_view(task), lease=task.lease, lease_s=lease_s)


@router.post("/claim", response_model=ClaimView, responses={204: {"description": "no task"}})
async def claim(
    body: Annotated[Claim, Body(examples=[{"worker": "robot-7", "tasks": ["arm"]}])],
    service: ServiceDependency,
    request: Request,
) -> ClaimView | Response:
    """The oldest free task; waits for one for `wait_s` seconds."""
    async for _ in looks(body.wait_s):
        if await request.is_disconnected():
            break
        task = await anyio.to_thread.run_sync(service.claim, body.worker, body.tasks)
        if task is None:
            continue
        if not await request.is_disconnected():
            return claim_view(task)
        assert task.lease is not None
        release = partial(visit_store.release, service.database, task.id, task.lease)
        await anyio.to_thread.run_sync(release)  # for a client that is still there
        break
    return Response(status_code=status.HTTP_204_NO_CONTENT)


@router.get("")
def list_tasks(
    service: ServiceDependency,
    state: Annotated[VisitState | None, Query(description="only tasks in this state")] = None,
    run_id: Annotated[str | None, Query(description="only tasks of this run")] = None,
    external: Annotated[bool | None, Query(description="for robots, not simulated")] = None,
    page_size: PageSize = 100,
    page_token: PageToken = 0,
) -> Page[TaskView]:
    """Visits to targets, in order."""
    tasks = visit_store.list_visits(
        service.database,
        states=None if state is None else [state],
        run_id=run_id,
        external=external,
        after=page_token,
        limit=page_size + 1,
    )
    return page_of(tasks, page_size, task_view, lambda task: task.number)


@router.get("/{task_id}")
def get_task(task_id: TargetTaskId, service: ServiceDependency) -> TaskView:
    """State, claimant and progress of a task."""
    return task_view(visit_store.get_visit(service.database, task_id))


@router.get("/{task_id}/policy", response_class=Response)
def policy(task_id: TargetTaskId, service: ServiceDependency) -> Response:
    """Policy to act with, as safetensors; 404 if the task asks for random actions."""
    return bytes_response(
        visit_store.policy_of(service.database, task_id), f"{task_id}.safetensors"
    )


@router.post("/{task_id}/heartbeat")
def heartbeat(
    task_id: TargetTaskId, body: Annotated[Heartbeat, Body()], service: ServiceDependency
) -> HeartbeatView:
    """Renew the lease; the answer has its new end, and whether to stop."""
    now, lease_s = service.orchestrator.clock.now(), service.settings.lease_s
    lease = visit_store.heartbeat(service.database, task_id, body.lease, body.steps, now, lease_s)
    return HeartbeatView(lease_expires_at=lease.expires_at, cancel_requested=not lease.is_wanted)


async def _good_lease(
    task_id: TargetTaskId,
    lease: Annotated[_Lease, Header(description="that the claim gave")],
    service: ServiceDependency,
) -> str:
    """The lease in the header. Raises LeaseLost or NotFound unless it is that of the task."""
    await anyio.to_thread.run_sync(visit_store.claimed_by, service.database, task_id, lease)
    return lease


async def _trajectory(
    request: Request,
    _octets: Annotated[None, Depends(octets)],
    lease: Annotated[str, Depends(_good_lease)],
) -> tuple[str, bytes]:
    """The lease and the body, which is received only where the lease is good."""
    return lease, await request.body()


@router.put("/{task_id}/trajectory", max_body_size=LARGEST, openapi_extra=content_described())
def upload(
    task_id: TargetTaskId,
    sent: Annotated[tuple[str, bytes], Depends(_trajectory)],
    service: ServiceDependency,
) -> TaskView:
    """Upload the trajectory, an `.npz` like a recording, with `rewards`; accepted once."""
    lease, content = sent
    return task_view(service.orchestrator.complete_task(task_id, lease, content))


@router.post("/{task_id}/release")
def release(
    task_id: TargetTaskId, body: Annotated[Release, Body()], service: ServiceDependency
) -> TaskView:
    """Give the task back for another claim."""
    return task_view(visit_store.release(service.database, task_id, body.lease))


@router.post("/{task_id}/fail")
def fail(
    task_id: TargetTaskId, body: Annotated[Failure, Body()], service: ServiceDependency
) -> TaskView:
    """Report that no robot can do the task: its run fails with the message, and can be resumed."""
    return task_view(service.orchestrator.fail_task(task_id, body.lease, body.message))

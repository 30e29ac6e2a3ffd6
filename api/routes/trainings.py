"""/v1/runs/{id}/trainings: the learning curves and policies of a run's trainings."""

from collections.abc import Sequence
from datetime import datetime

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field

from adr_service.events import StageFinished, TrainingEvaluated
from adr_service.training.curve import Evaluation
from api.parameters import Digest, RunId
from api.routes.downloads import bytes_response
from api.service import ServiceDependency
from db import events as event_store
from db import runs as run_store
from db import stages as stage_store
from db.errors import NotFound
from db.events import EventRecord
from db.session import Database

router = APIRouter(prefix="/v1/runs", tags=["runs"])


class CurvePoint(Evaluation):
    """A point of a learning curve, and when it was stored."""

    time: datetime


class TrainingView(BaseModel):
    """A policy's training, finished or not."""

    digest: str
    is_finished: bool
    adjusted_draws: int | None = Field(
        description="dynamics moved onto a bound of what can be simulated; null until it ends"
    )
    diverged_episodes: int | None = Field(
        description="ended because the simulation was not finite any more; null until it ends"
    )
    curve: list[CurvePoint]
    links: dict[str, str] = Field(
        description="`policy`: what is kept of it; archives have none of unfinished trainings"
    )


def training_views(
    database: Database, run_id: str, records: Sequence[EventRecord]
) -> list[TrainingView]:
    """Return the trainings of a run, in the order of their first evaluation."""
    curves: dict[str, list[CurvePoint]] = {}
    finished: set[str] = set()
    for record in records:
        event = record.event
        if isinstance(event, TrainingEvaluated):
            point = event.model_dump(include=set(Evaluation.model_fields))
            stored = CurvePoint(**point, time=record.created_at)
            curves.setdefault(event.digest, []).append(stored)
        elif isinstance(event, StageFinished):
            finished.add(event.digest)
    results = stage_store.values_of(database, list(curves))
    with_policy = results.keys() | stage_store.checkpoints_of(database, list(curves))
    views: list[TrainingView] = []
    for digest, curve in curves.items():
        result = results.get(digest, {}) if digest in finished else {}
        view = TrainingView(
            digest=digest,
            is_finished=digest in finished,
            adjusted_draws=result.get("adjusted_draws"),
            diverged_episodes=result.get("diverged_episodes"),
            curve=sorted(curve, key=lambda point: point.steps),
            links={"policy": f"/v1/runs/{run_id}/trainings/{digest}/policy"}
            if digest in with_policy
            else {},
        )
        views.append(view)
    return views


@router.get("/{run_id}/trainings")
def trainings(run_id: RunId, service: ServiceDependency) -> list[TrainingView]:
    """Learning curves of the policies, also of those in training."""
    records = event_store.events_of(service.database, run_id)
    return training_views(service.database, run_id, records)


@router.get("/{run_id}/trainings/{digest}/policy", response_class=Response)
def policy_of_training(run_id: RunId, digest: Digest, service: ServiceDependency) -> Response:
    """Policy of a training; while it goes on, the best so far."""
    run_store.get_run(service.database, run_id)
    points = event_store.all_of(service.database, [run_id], TrainingEvaluated)
    is_its_own = any(point.digest == digest for _, point in points)
    content = stage_store.policy_of_training(service.database, digest) if is_its_own else None
    if content is None:
        raise NotFound("policy of training", digest)
    return bytes_response(content, f"{digest[:12]}.safetensors")

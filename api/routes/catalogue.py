"""Tasks, methods and presets to choose from, and the state of the service."""

from typing import Any

from fastapi import APIRouter, Response
from pydantic import TypeAdapter

import adr_service
from adr_service.client.robot.playback import about
from adr_service.methods.catalogue import AnyMethod
from adr_service.presets import PRESETS
from adr_service.tasks.catalogue import catalogue
from api.metrics import CONTENT_TYPE, exposition
from api.parameters import Digest
from api.routes.downloads import artifact_response
from api.service import ServiceDependency
from workers.cluster import ClusterUnavailable

router = APIRouter(tags=["catalogue"])
_SILENT_S = 10.0  # after which the silent dispatcher is reported


@router.get("/v1/tasks")
def tasks() -> list[dict[str, Any]]:
    """Tasks, their variants, and the parameters that methods may infer."""
    return [
        {
            **about(entry.task),
            "horizon": entry.task.horizon,
            "reward_threshold": entry.task.reward_threshold,
            "variants": {
                variant_name: [
                    {"name": p.name, "unit": p.unit, "low": p.low, "high": p.high}
                    for p in variant.source.space.parameters
                ]
                for variant_name, variant in entry.variants.items()
            },
        }
        for entry in catalogue().values()
    ]


@router.get("/v1/methods")
def methods() -> dict[str, Any]:
    """The JSON schema of every method's settings."""
    return TypeAdapter(AnyMethod).json_schema()


@router.get("/v1/presets")
def presets() -> dict[str, dict[str, Any]]:
    """Defaults of a spec, by preset."""
    return PRESETS


@router.get("/v1/artifacts/{digest}", response_class=Response)
def artifact(digest: Digest, service: ServiceDependency) -> Response:
    """Stored bytes, by their SHA-256."""
    return artifact_response(service, digest, digest)


@router.head("/healthz", include_in_schema=False)  # some monitors ask for no more
@router.get("/healthz")
async def healthz() -> dict[str, str]:  # it waits for no thread
    """Answers while the process lives."""
    return {"status": "ok"}


@router.head("/readyz", include_in_schema=False)
@router.get("/readyz", response_model=None)
def readyz(service: ServiceDependency) -> dict[str, Any]:
    """Answers 200 if the database can be written, the disk has room and Ray is reachable."""
    service.check_disk()
    with service.database.write("readyz") as session:
        session.connection()  # begins a transaction, which takes the lock to write
    if not service.orchestrator.is_alive:
        raise ClusterUnavailable("Ray has stopped; restart the service")
    if (silent := service.orchestrator.silent_s) > _SILENT_S:
        raise ClusterUnavailable(
            f"the dispatcher has waited for Ray or the database for {silent:.0f} s"
        )
    return {
        "status": "ready",
        "cores": service.orchestrator.cores,
        "dashboard": service.dashboard_url,
    }


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def metrics(service: ServiceDependency) -> Response:
    """Metrics for Prometheus."""
    return Response(exposition(service), media_type=CONTENT_TYPE)


@router.get("/version")
async def version() -> dict[str, str]:
    """Version of the service."""
    return {"version": adr_service.__version__}

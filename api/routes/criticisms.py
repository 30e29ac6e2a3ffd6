"""/v1/criticisms: what measured data say that a task's simulator gets wrong.

A criticism is a run: it is watched, cancelled, resumed and deleted as `/v1/runs/{id}`.
"""

from fastapi import APIRouter, Response, status

from adr_service.criticism.report import FILES
from adr_service.errors import UnknownName
from adr_service.events import CriticismFinished
from adr_service.specs import CriticismSpec
from api.bodies import CriticismBody
from api.routes.runs import artifact_response, run_view_of, start
from api.service import IdempotencyKey, Service, ServiceDependency
from api.views import CriticismView, criticism_view
from db import events as event_store
from db import runs as run_store
from db.errors import NotFound
from db.runs import RunRecord

router = APIRouter(prefix="/v1/criticisms", tags=["criticisms"])
_MEDIA = {"html": "text/html", "json": "application/json", "xml": "application/xml"}


@router.post("", status_code=status.HTTP_202_ACCEPTED)
def submit(
    spec: CriticismBody,
    service: ServiceDependency,
    response: Response,
    idempotency_key: IdempotencyKey = None,
) -> CriticismView:
    """Store a criticism and start it."""
    service.check_dataset(spec)
    record = start(service, spec, idempotency_key)
    response.headers["Location"] = f"/v1/criticisms/{record.id}"
    return criticism_view(run_view_of(service, record), None)


@router.get("/{run_id}")
def get_criticism(run_id: str, service: ServiceDependency) -> CriticismView:
    """How it stands, and the verdict as soon as there is one."""
    record = _criticism(service, run_id)
    return criticism_view(run_view_of(service, record), _finished(service, run_id))


@router.get("/{run_id}/{name}", response_class=Response)
def file(run_id: str, name: str, service: ServiceDependency) -> Response:
    """`report.html`, `verdict.json` and, where something was named, `extended.xml` and
    `effects.json`."""
    if name not in FILES:
        raise UnknownName("file of a criticism", name, FILES)
    _criticism(service, run_id)
    finished = _finished(service, run_id)
    if finished is None or name not in finished.files:
        raise NotFound(f"{name} of criticism", run_id)
    response = artifact_response(service, finished.files[name], name)
    response.headers["Content-Type"] = _MEDIA[name.rpartition(".")[2]]
    if name == "report.html":
        response.headers["Content-Disposition"] = "inline"  # to be read
    return response


def _criticism(service: Service, run_id: str) -> RunRecord:
    record = run_store.get_run(service.database, run_id)
    if not isinstance(record.spec, CriticismSpec):
        raise NotFound("criticism", run_id)
    return record


def _finished(service: Service, run_id: str) -> CriticismFinished | None:
    for record in event_store.events_of(service.database, run_id, type="criticism_finished"):
        if isinstance(record.event, CriticismFinished):
            return record.event
    return None

"""/v1/criticisms: verdicts on a task's simulator, given measured data.

A criticism is a run: `/v1/runs/{id}` watches, cancels, resumes and deletes it.
"""

from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, Response, status
from pydantic import BaseModel

from adr_service.criticism.report import FILES
from adr_service.errors import UnknownName
from adr_service.events import CriticismFinished
from adr_service.specs import CriticismSpec
from api.bodies import CriticismBody
from api.parameters import FileName, RunId
from api.routes.downloads import artifact_response
from api.routes.submissions import IdempotencyKey, start_run
from api.service import Service, ServiceDependency
from api.views import RunView, run_view
from db import events as event_store
from db import runs as run_store
from db.errors import NotFound
from db.runs import RunRecord

router = APIRouter(prefix="/v1/criticisms", tags=["criticisms"])
_TYPES = {"html": "text/html", "json": "application/json", "xml": "application/xml"}


class CriticismView(BaseModel):
    """A criticism: its run, and its verdict once the run has finished."""

    run: RunView
    verdict: dict[str, Any] | None  # as `adr criticise` writes it
    links: dict[str, str]


def criticism_view(run: RunView, finished: CriticismFinished | None) -> CriticismView:
    """Return a criticism with links to its files."""
    here = f"/v1/criticisms/{run.id}"
    files = {} if finished is None else {name: f"{here}/{name}" for name in finished.files}
    return CriticismView(
        run=run,
        verdict=None if finished is None else finished.verdict,
        links={"self": here, "run": run.links["self"], **files},
    )


def criticism_views(service: Service, records: Sequence[RunRecord]) -> list[CriticismView]:
    """Return criticisms; one query finds the verdicts of all."""
    ids = [record.id for record in records]
    finished = dict(event_store.all_of(service.database, ids, CriticismFinished))
    return [criticism_view(run_view(service, run), finished.get(run.id)) for run in records]


@router.post("", status_code=status.HTTP_202_ACCEPTED)
def submit(
    spec: CriticismBody,
    service: ServiceDependency,
    response: Response,
    idempotency_key: IdempotencyKey = None,
) -> CriticismView:
    """Store a criticism and start it."""
    service.check_dataset(spec)
    record = start_run(service, spec, idempotency_key)
    response.headers["Location"] = f"/v1/criticisms/{record.id}"
    (view,) = criticism_views(service, [record])  # a repeated request may find it finished
    return view


@router.get("/{run_id}")
def get_criticism(run_id: RunId, service: ServiceDependency) -> CriticismView:
    """State of a criticism, and its verdict once there is one."""
    (view,) = criticism_views(service, [_criticism(service, run_id)])
    return view


@router.get("/{run_id}/{name}", response_class=Response)
def file(run_id: RunId, name: FileName, service: ServiceDependency) -> Response:
    """A file: `report.html`, `verdict.json`; with causes also `extended.xml`, `effects.json`."""
    if name not in FILES:
        raise UnknownName("file of a criticism", name, FILES)
    _criticism(service, run_id)
    finished = _finished(service, run_id)
    if finished is None or name not in finished.files:
        raise NotFound(f"{name} of criticism", run_id)
    response = artifact_response(service, finished.files[name], name)
    response.headers["Content-Type"] = _TYPES[name.rpartition(".")[2]]
    if name == "report.html":
        response.headers["Content-Disposition"] = "inline"  # to be read
    return response


def _criticism(service: Service, run_id: str) -> RunRecord:
    record = run_store.get_run(service.database, run_id)
    if not isinstance(record.spec, CriticismSpec):
        raise NotFound("criticism", run_id)
    return record


def _finished(service: Service, run_id: str) -> CriticismFinished | None:
    found = dict(event_store.all_of(service.database, [run_id], CriticismFinished))
    return found.get(run_id)

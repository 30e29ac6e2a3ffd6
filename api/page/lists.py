"""The pages of robots, datasets, criticisms, claims, and the API's reference."""

from typing import Annotated

from fastapi import APIRouter, File, Form, Request, Response, UploadFile
from fastapi.responses import RedirectResponse
from pydantic import TypeAdapter, ValidationError

from adr_service.errors import InvalidInput
from adr_service.json_values import explain
from adr_service.specs import CriticismSpec
from adr_service.tasks.catalogue import catalogue, variants
from adr_service.transitions import dataset_id
from api.claims import claim_reports
from api.page.rendering import SEE_OTHER, UNPROCESSABLE, show
from api.routes import criticisms as routes
from api.routes.datasets import dataset_view
from api.routes.submissions import start_run
from api.routes.target_tasks import task_view
from api.service import Service, ServiceDependency
from api.uploads import LARGEST, FileName, Upload, check_dataset
from db import datasets as dataset_store
from db import runs as run_store
from db import visits as visit_store

router = APIRouter(include_in_schema=False)
_SHOWN = 200
_MOST_CRITICISMS = 50  # each with its verdict
_LONGEST = 80  # characters of a file's name that a refusal repeats


@router.get("/robots")
def robots(request: Request, service: ServiceDependency) -> Response:
    visits = visit_store.list_visits(
        service.database, external=True, limit=_SHOWN, newest_first=True
    )
    return show(
        request,
        "robots.html",
        live=True,
        heading="Robots",
        explanation="Visits to targets outside of this service, the newest first. A robot’s client "
        "claims one, acts, and uploads what it measured.",
        items=[task_view(visit) for visit in visits],
        more=len(visits) == _SHOWN,
        now=service.orchestrator.clock.now(),
    )


@router.get("/datasets")
def datasets(request: Request, service: ServiceDependency) -> Response:
    records = dataset_store.list_datasets(service.database, limit=_SHOWN, newest_first=True)
    return show(
        request,
        "datasets.html",
        heading="Datasets",
        explanation="Recordings of transitions, and measurements of states and commands: methods "
        "learn from them, and simulators are criticised by them.",
        items=[dataset_view(record) for record in records],
        more=len(records) == _SHOWN,
    )


@router.get("/criticisms")
def criticisms(request: Request, service: ServiceDependency) -> Response:
    return _criticisms(request, service, "arm", "vanilla", [])


@router.post("/criticisms", max_body_size=LARGEST)
def submit_criticism(
    request: Request,
    service: ServiceDependency,
    measurement: Annotated[UploadFile, File()],
    task: Annotated[str, Form(max_length=100)],
    variant: Annotated[str, Form(max_length=100)],
) -> Response:
    """Store what a robot did, and start a criticism by it."""
    content = measurement.file.read()
    try:
        name = TypeAdapter(FileName | None).validate_python(measurement.filename)
    except ValidationError:
        given = f"{measurement.filename or '':.{_LONGEST}}"
        wrong = (
            "the file’s name must be one line of 255 characters at most, without control "
            f"characters; given {given!r}"
        )
        return _criticisms(request, service, task, variant, [wrong])
    try:
        spec = CriticismSpec.model_validate(
            {"task": task, "variant": variant, "dataset": dataset_id(content)}
        )
        upload = Upload.parse(content)
        check_dataset(spec, upload.content)  # before anything is stored
        service.check_disk()
        dataset_store.store_dataset(service.database, upload.content, upload.data, name)
        record = start_run(service, spec, None)
    except ValidationError as error:
        return _criticisms(request, service, task, variant, [explain(error, "the form")])
    except InvalidInput as error:
        told = measurement.filename or "the file"
        return _criticisms(request, service, task, variant, [f"{told}: {error}"])
    return RedirectResponse(f"/runs/{record.id}", SEE_OTHER)


def _criticisms(
    request: Request, service: Service, task: str, variant: str, errors: list[str]
) -> Response:
    """The list, and the form with what was given and what is wrong with it."""
    runs = run_store.list_runs(
        service.database, method="criticism", limit=_MOST_CRITICISMS, newest_first=True
    )
    return show(
        request,
        "criticisms.html",
        live=any(not run.is_finished for run in runs) and not errors,
        status_code=UNPROCESSABLE if errors else 200,
        heading="Criticisms",
        explanation="What data of a robot say that its simulator gets wrong: its cause, and the "
        "simulator extended by it.",
        errors=errors,
        given={"task": task, "variant": variant},
        tasks=list(catalogue()),
        variants=variants(),
        items=routes.criticism_views(service, runs),
        more=len(runs) == _MOST_CRITICISMS,
        origins=dataset_store.origins_of(
            service.database, (r.spec.dataset for r in runs if isinstance(r.spec, CriticismSpec))
        ),
    )


@router.get("/claims")
def claims(request: Request, service: ServiceDependency) -> Response:
    return show(request, "claims.html", claims=claim_reports(service))


@router.get("/docs")
def docs(request: Request) -> Response:
    """The API's reference, made from its description."""
    return show(request, "docs.html", api=request.app.openapi())

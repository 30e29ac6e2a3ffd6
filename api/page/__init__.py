"""The pages: benchmarks and runs at a glance, rendered on the server, without scripts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.templating import Jinja2Templates

from adr_service.benchmark.claims import reports
from adr_service.benchmark.comparison import Outcome, table
from adr_service.benchmark.figures import FIGURES, drawable
from adr_service.errors import remedy_of
from api.routes.benchmarks import summaries, view
from api.routes.runs import run_view_of
from api.service import Service, ServiceDependency
from db import benchmarks as benchmark_store
from db import events as event_store
from db import runs as run_store

router = APIRouter(include_in_schema=False)
_SHOWN = 100  # of each list on the first page; the API has the rest
_templates = Jinja2Templates(Path(__file__).parent / "templates")


@router.get("/")
def index(request: Request, service: ServiceDependency) -> Response:
    benchmarks, single = benchmark_store.latest(service.database, _SHOWN)
    summary = summaries(service, benchmarks)
    return _templates.TemplateResponse(
        request,
        "index.html",
        {
            "benchmarks": [summary(record) for record in benchmarks],
            "runs": single,
            "ray": service.dashboard_url,
        },
    )


@router.get("/docs")
def docs(request: Request) -> Response:
    """The API's reference, from its own description."""
    description = request.app.openapi()
    return _templates.TemplateResponse(request, "docs.html", {"api": description})


@router.get("/runs/{run_id}")
def run(run_id: str, request: Request, service: ServiceDependency) -> Response:
    record = run_store.get_run(service.database, run_id)
    code = record.error_code
    return _templates.TemplateResponse(
        request,
        "run.html",
        {
            "run": run_view_of(service, record),
            "remedy": None if code is None else remedy_of(code),
            "is_finished": record.is_finished,
            "events": event_store.events_of(service.database, run_id),
            **_found(service, service.outcomes([record])),
        },
    )


@router.get("/benchmarks/{benchmark_id}")
def benchmark(benchmark_id: str, request: Request, service: ServiceDependency) -> Response:
    shown = view(service, benchmark_store.get_benchmark(service.database, benchmark_id))
    outcomes = service.outcomes(benchmark_store.runs_of(service.database, benchmark_id))
    return _templates.TemplateResponse(
        request,
        "benchmark.html",
        {
            "benchmark": shown,
            **_found(service, outcomes),
            # bootstraps take a moment: not at every refresh of what changes anyway
            "claims": reports(outcomes) if shown.is_finished else [],
        },
    )


def _found(service: Service, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """What was found so far, and where it is computed."""
    return {
        "rows": table(outcomes),
        "figures": drawable(outcomes),
        "captions": {name: kind.caption for name, kind in FIGURES.items()},
        "ray": service.dashboard_url,
    }

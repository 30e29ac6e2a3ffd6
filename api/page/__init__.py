"""The page: benchmarks at a glance, rendered on the server, without scripts."""

from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.templating import Jinja2Templates

from adr_service.benchmark.claims import reports
from adr_service.benchmark.comparison import table
from adr_service.benchmark.figures import FIGURES, drawable
from api.routes.benchmarks import summaries, view
from api.service import ServiceDependency
from db import runs as store

router = APIRouter(include_in_schema=False)
_SHOWN = 100  # of each list on the first page; the API has the rest
_templates = Jinja2Templates(Path(__file__).parent / "templates")


@router.get("/")
def index(request: Request, service: ServiceDependency) -> Response:
    benchmarks, single = store.latest(service.database, _SHOWN)
    summary = summaries(service, benchmarks)
    return _templates.TemplateResponse(
        request,
        "index.html",
        {
            "benchmarks": [summary(record) for record in benchmarks],
            "runs": single,
            "ray": service.orchestrator.dashboard_url,
        },
    )


@router.get("/docs")
def docs(request: Request) -> Response:
    """The API's reference, from its own description."""
    description = request.app.openapi()
    return _templates.TemplateResponse(request, "docs.html", {"api": description})


@router.get("/benchmarks/{benchmark_id}")
def benchmark(benchmark_id: str, request: Request, service: ServiceDependency) -> Response:
    shown = view(service, store.get_benchmark(service.database, benchmark_id))
    outcomes = service.outcomes(store.runs_of(service.database, benchmark_id))
    return _templates.TemplateResponse(
        request,
        "benchmark.html",
        {
            "benchmark": shown,
            "rows": table(outcomes),
            "figures": drawable(outcomes),
            "captions": {name: kind.caption for name, kind in FIGURES.items()},
            # bootstraps take a moment: not at every refresh of what changes anyway
            "claims": reports(outcomes) if shown.is_finished else [],
        },
    )

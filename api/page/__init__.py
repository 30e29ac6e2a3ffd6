"""The pages: benchmarks and runs at a glance, rendered on the server, without scripts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.templating import Jinja2Templates

from adr_service.benchmark.aggregate import aggregates
from adr_service.benchmark.claims import reports
from adr_service.benchmark.comparison import Outcome, table
from adr_service.benchmark.figures import FIGURES, drawable
from adr_service.errors import remedy_of
from api.results import outcomes_of
from api.service import Service, ServiceDependency
from api.views import benchmark_summaries, benchmark_view, run_view
from db import benchmarks as benchmark_store
from db import events as event_store
from db import runs as run_store

router = APIRouter(include_in_schema=False)
_SHOWN = 100  # of each list on the first page; the API has the rest
_templates = Jinja2Templates(Path(__file__).parent / "templates")


@router.get("/")
def index(request: Request, service: ServiceDependency) -> Response:
    benchmarks, single = benchmark_store.latest(service.database, _SHOWN)
    return _templates.TemplateResponse(
        request,
        "index.html",
        {
            "benchmarks": benchmark_summaries(service, benchmarks),
            "runs": single,
            "ray": service.dashboard_url,
        },
    )


@router.get("/docs")
def docs(request: Request) -> Response:
    """The API's reference, made from its description."""
    description = request.app.openapi()
    return _templates.TemplateResponse(request, "docs.html", {"api": description})


@router.get("/runs/{run_id}")
def run(run_id: str, request: Request, service: ServiceDependency) -> Response:
    record = run_store.get_run(service.database, run_id)
    outcomes = outcomes_of(service, [record])
    return _templates.TemplateResponse(
        request,
        "run.html",
        {
            "run": run_view(service, record),
            "remedy": None if record.error_code is None else remedy_of(record.error_code),
            "is_finished": record.is_finished,
            "events": event_store.events_of(service.database, run_id),
            "inferences": [each.iteration for each in outcomes if each.iteration.diagnostics],
            **_results(service, outcomes),
        },
    )


@router.get("/benchmarks/{benchmark_id}")
def benchmark(benchmark_id: str, request: Request, service: ServiceDependency) -> Response:
    shown = benchmark_view(service, benchmark_store.get_benchmark(service.database, benchmark_id))
    outcomes = outcomes_of(service, benchmark_store.runs_of(service.database, benchmark_id))
    return _templates.TemplateResponse(
        request,
        "benchmark.html",
        {
            "benchmark": shown,
            **_results(service, outcomes),
            # bootstraps take a moment: not at every refresh of what changes anyway
            "claims": reports(outcomes) if shown.is_finished else [],
            "aggregates": aggregates(outcomes) if shown.is_finished else [],
        },
    )


def _results(service: Service, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the results so far, and the address of the cluster's dashboard."""
    return {
        "rows": table(outcomes),
        "figures": drawable(outcomes),
        "captions": {name: kind.caption for name, kind in FIGURES.items()},
        "ray": service.dashboard_url,
    }

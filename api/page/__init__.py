"""The page: benchmarks at a glance, rendered on the server, without scripts."""

from pathlib import Path

from fastapi import APIRouter, Request, Response
from fastapi.templating import Jinja2Templates

from adr_service.benchmark.comparison import table
from api.routes.benchmarks import view
from api.service import ServiceDependency
from db import runs as store

router = APIRouter(include_in_schema=False)
_templates = Jinja2Templates(Path(__file__).parent / "templates")


@router.get("/")
def index(request: Request, service: ServiceDependency) -> Response:
    benchmarks = [view(service, b) for b in store.list_benchmarks(service.database, limit=1000)]
    single = [r for r in store.list_runs(service.database, limit=1000) if r.benchmark_id is None]
    return _templates.TemplateResponse(
        request,
        "index.html",
        {
            "benchmarks": benchmarks[::-1],
            "runs": single[::-1],
            "ray": service.orchestrator.dashboard_url,
        },
    )


@router.get("/benchmarks/{benchmark_id}")
def benchmark(benchmark_id: str, request: Request, service: ServiceDependency) -> Response:
    shown = view(service, store.get_benchmark(service.database, benchmark_id))
    outcomes = service.outcomes(store.runs_of(service.database, benchmark_id))
    inferred = any(outcome.spec.method.name in {"simopt", "dropo"} for outcome in outcomes)
    return _templates.TemplateResponse(
        request,
        "benchmark.html",
        {"benchmark": shown, "rows": table(outcomes), "inferred": inferred},
    )

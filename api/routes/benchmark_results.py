"""/v1/benchmarks/{id}/results and its claims, figures and cost."""

from dataclasses import asdict
from typing import Any

from fastapi import APIRouter, Response

from adr_service.benchmark.claims import reports
from adr_service.benchmark.comparison import Outcome
from adr_service.benchmark.figures import drawable
from api.parameters import RENEWED, BenchmarkId, FigureName, FileFormat, TableFormat
from api.results import CostView, ResultsView, cost_of, outcomes_of, results_json
from api.routes.downloads import CSV, bibtex_response, csv_response, figure_response
from api.service import Service, ServiceDependency
from db import benchmarks as benchmark_store

router = APIRouter(prefix="/v1/benchmarks", tags=["benchmarks"])


@router.get("/{benchmark_id}/results", response_model=ResultsView, responses=CSV)
def results(
    benchmark_id: BenchmarkId, service: ServiceDependency, format: TableFormat = "json"
) -> Response:
    """Result table of all methods after every iteration, comparisons, estimates and costs."""
    if format == "csv":
        return csv_response(benchmark_id, _outcomes(service, benchmark_id))
    records = benchmark_store.runs_of(service.database, benchmark_id)
    return Response(results_json(service, benchmark_id, records), media_type="application/json")


@router.get("/{benchmark_id}/claims")
def claims(benchmark_id: BenchmarkId, service: ServiceDependency) -> list[dict[str, Any]]:
    """The paper's claims, compared with this benchmark alone."""
    return [asdict(report) for report in reports(_outcomes(service, benchmark_id))]


@router.get("/{benchmark_id}/cost")
def cost(benchmark_id: BenchmarkId, service: ServiceDependency) -> CostView:
    """Cost of the stages, and utilisation of the cores."""
    return cost_of(service, benchmark_store.runs_of(service.database, benchmark_id))


@router.get("/{benchmark_id}/citations", response_class=Response)
def citations(benchmark_id: BenchmarkId, service: ServiceDependency) -> Response:
    """The papers of what was run, as BibTeX."""
    return bibtex_response(benchmark_store.runs_of(service.database, benchmark_id))


@router.get("/{benchmark_id}/figures")
def figures(benchmark_id: BenchmarkId, service: ServiceDependency) -> list[str]:
    """Names of the figures that can be drawn by now."""
    return drawable(_outcomes(service, benchmark_id))


@router.get(
    "/{benchmark_id}/figures/{name}.{file_format}", response_class=Response, dependencies=[RENEWED]
)
def figure(
    benchmark_id: BenchmarkId, name: FigureName, file_format: FileFormat, service: ServiceDependency
) -> Response:
    """A figure, or its numbers as CSV."""
    return figure_response(benchmark_id, name, _outcomes(service, benchmark_id), file_format)


def _outcomes(service: Service, benchmark_id: str) -> list[Outcome]:
    return outcomes_of(service, benchmark_store.runs_of(service.database, benchmark_id))

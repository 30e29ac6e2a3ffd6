"""/v1/benchmarks: grids of runs, their results and figures."""

from contextlib import suppress
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Query, Response, status

from adr_service.benchmark.claims import reports
from adr_service.benchmark.comparison import table, to_csv
from adr_service.benchmark.figures import Format, draw, drawable
from adr_service.specs import BenchmarkExtension, BenchmarkSpec
from api.routes.runs import MEDIA, PageSize, plan_here
from api.service import Service, ServiceDependency
from api.views import (
    BenchmarkView,
    CostView,
    Page,
    ResultsView,
    benchmark_view,
    page_of,
    results_view,
    run_view,
)
from db import runs as store
from db.errors import NotPossible
from db.runs import BenchmarkRecord

router = APIRouter(prefix="/v1/benchmarks", tags=["benchmarks"])


@router.post("", status_code=status.HTTP_202_ACCEPTED, response_model=None)
def submit(
    spec: Annotated[BenchmarkSpec, Body()],
    service: ServiceDependency,
    response: Response,
    validate_only: bool = False,
) -> BenchmarkView | dict[str, Any]:
    """Store a benchmark and start its runs; with `validate_only`, say what it would cost."""
    if validate_only:
        response.status_code = status.HTTP_200_OK
        runs = list(spec.runs())
        return {"spec": spec, "runs": runs, "plan": asdict(plan_here(service, runs))}
    record = store.create_benchmark(service.database, spec)
    for run in store.runs_of(service.database, record.id):
        service.orchestrator.submit(run)
    response.headers["Location"] = f"/v1/benchmarks/{record.id}"
    return view(service, record)


@router.get("")
def list_benchmarks(
    service: ServiceDependency,
    page_size: PageSize = 100,
    page_token: Annotated[int, Query(ge=0, lt=2**63)] = 0,
) -> Page[BenchmarkView]:
    """Benchmarks in order of submission."""
    found = store.list_benchmarks(service.database, after=page_token, limit=page_size + 1)
    return page_of(found, page_size, partial(view, service), lambda record: record.number)


@router.get("/{benchmark_id}")
def get_benchmark(benchmark_id: str, service: ServiceDependency) -> BenchmarkView:
    return view(service, store.get_benchmark(service.database, benchmark_id))


@router.post("/{benchmark_id}/cancel", status_code=status.HTTP_202_ACCEPTED)
def cancel(benchmark_id: str, service: ServiceDependency) -> BenchmarkView:
    """Ask every live run to stop."""
    for run in store.runs_of(service.database, benchmark_id):
        with suppress(NotPossible):  # it has ended, before or meanwhile
            service.orchestrator.cancel(store.request_cancel(service.database, run.id))
    return get_benchmark(benchmark_id, service)


@router.post("/{benchmark_id}/resume", status_code=status.HTTP_202_ACCEPTED)
def resume(benchmark_id: str, service: ServiceDependency) -> BenchmarkView:
    """Go on with every failed or cancelled run."""
    for run in store.runs_of(service.database, benchmark_id):
        with suppress(NotPossible):  # it needs no resuming
            service.orchestrator.submit(store.resubmit(service.database, run.id))
    return get_benchmark(benchmark_id, service)


@router.post("/{benchmark_id}/extend", status_code=status.HTTP_202_ACCEPTED)
def extend(
    benchmark_id: str,
    extension: Annotated[BenchmarkExtension, Body()],
    service: ServiceDependency,
) -> BenchmarkView:
    """Add seeds, methods, tasks, variants or collectors; nothing is computed twice."""
    for run in store.extend_benchmark(service.database, benchmark_id, extension):
        service.orchestrator.submit(run)
    return get_benchmark(benchmark_id, service)


@router.delete("/{benchmark_id}", status_code=status.HTTP_204_NO_CONTENT)
def delete(benchmark_id: str, service: ServiceDependency) -> None:
    """Delete a finished benchmark with its runs and what only they refer to."""
    store.delete_benchmark(service.database, benchmark_id)


@router.get("/{benchmark_id}/results", response_model=None)
def results(
    benchmark_id: str, service: ServiceDependency, format: Literal["json", "csv"] = "json"
) -> ResultsView | Response:
    outcomes = service.outcomes(store.runs_of(service.database, benchmark_id))
    if format == "csv":
        return Response(to_csv(table(outcomes)), media_type="text/csv")
    return results_view(outcomes)


@router.get("/{benchmark_id}/claims")
def claims(benchmark_id: str, service: ServiceDependency) -> list[dict[str, Any]]:
    """What the paper claims, against this benchmark alone."""
    outcomes = service.outcomes(store.runs_of(service.database, benchmark_id))
    return [asdict(report) for report in reports(outcomes)]


@router.get("/{benchmark_id}/cost")
def cost(benchmark_id: str, service: ServiceDependency) -> CostView:
    """What its stages cost, and how busy the cores were."""
    return service.cost(store.runs_of(service.database, benchmark_id))


@router.get("/{benchmark_id}/figures")
def figures(benchmark_id: str, service: ServiceDependency) -> list[str]:
    """Names of the figures that can be drawn by now."""
    return drawable(service.outcomes(store.runs_of(service.database, benchmark_id)))


@router.get("/{benchmark_id}/figures/{name}.{file_format}", response_class=Response)
def figure(
    benchmark_id: str, name: str, file_format: Format, service: ServiceDependency
) -> Response:
    outcomes = service.outcomes(store.runs_of(service.database, benchmark_id))
    return Response(draw(name, outcomes, file_format), media_type=MEDIA[file_format])


def view(service: Service, record: BenchmarkRecord) -> BenchmarkView:
    records = store.runs_of(service.database, record.id)
    runs = [run_view(run, service.orchestrator.activities(run.id)) for run in records]
    return benchmark_view(record, runs, records)

"""/v1/benchmarks: grids of runs, their results and figures."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response, status

from adr_service.benchmark.claims import reports
from adr_service.benchmark.comparison import table, to_csv
from adr_service.benchmark.figures import Format, draw, drawable
from adr_service.specs import BenchmarkSpec
from api.bodies import BenchmarkBody, ExtensionBody
from api.routes.runs import CSV, MEDIA, PageSize, plan_here
from api.service import IdempotencyKey, Service, ServiceDependency, request_key
from api.views import (
    BenchmarkSummary,
    BenchmarkView,
    CostView,
    Page,
    PlannedBenchmark,
    ResultsView,
    benchmark_summary,
    benchmark_view,
    page_of,
    run_view,
)
from db import benchmarks as benchmark_store
from db.benchmarks import BenchmarkRecord
from db.requests import Replayed

router = APIRouter(prefix="/v1/benchmarks", tags=["benchmarks"])


@router.post(
    "",
    status_code=status.HTTP_202_ACCEPTED,
    responses={200: {"model": PlannedBenchmark, "description": "with `validate_only`"}},
)
def submit(
    spec: BenchmarkBody,
    service: ServiceDependency,
    response: Response,
    validate_only: bool = False,
    idempotency_key: IdempotencyKey = None,
) -> BenchmarkView | PlannedBenchmark:
    """Store a benchmark and start its runs; with `validate_only`, say what it would cost."""
    if validate_only:
        response.status_code = status.HTTP_200_OK
        runs = list(spec.runs())
        return PlannedBenchmark(spec=spec, runs=runs, plan=plan_here(service, runs))
    record = _start(service, spec, idempotency_key)
    response.headers["Location"] = f"/v1/benchmarks/{record.id}"
    return view(service, record)


@router.get("")
def list_benchmarks(
    service: ServiceDependency,
    page_size: PageSize = 100,
    page_token: Annotated[int, Query(ge=0, lt=2**63)] = 0,
) -> Page[BenchmarkSummary]:
    """Benchmarks in order of submission, without their runs."""
    found = benchmark_store.list_benchmarks(service.database, after=page_token, limit=page_size + 1)
    return page_of(found, page_size, summaries(service, found), lambda record: record.number)


@router.get("/{benchmark_id}")
def get_benchmark(benchmark_id: str, service: ServiceDependency) -> BenchmarkView:
    """How it stands, with all its runs."""
    return view(service, benchmark_store.get_benchmark(service.database, benchmark_id))


@router.post("/{benchmark_id}/cancel", status_code=status.HTTP_202_ACCEPTED)
def cancel(benchmark_id: str, service: ServiceDependency) -> BenchmarkView:
    """Ask every live run to stop."""
    service.orchestrator.cancel(*benchmark_store.request_cancel_all(service.database, benchmark_id))
    return get_benchmark(benchmark_id, service)


@router.post("/{benchmark_id}/resume", status_code=status.HTTP_202_ACCEPTED)
def resume(benchmark_id: str, service: ServiceDependency) -> BenchmarkView:
    """Go on with every failed or cancelled run."""
    for run in benchmark_store.resubmit_all(service.database, benchmark_id, service.check_queue):
        service.orchestrator.submit(run)
    return get_benchmark(benchmark_id, service)


@router.post("/{benchmark_id}/extend", status_code=status.HTTP_202_ACCEPTED)
def extend(
    benchmark_id: str,
    extension: ExtensionBody,
    service: ServiceDependency,
) -> BenchmarkView:
    """Add seeds, methods, tasks, variants or collectors; nothing is computed twice."""
    added = benchmark_store.extend_benchmark(
        service.database, benchmark_id, extension, service.check_queue
    )
    for run in added:
        service.orchestrator.submit(run)
    return get_benchmark(benchmark_id, service)


@router.delete("/{benchmark_id}", status_code=status.HTTP_204_NO_CONTENT)
def delete(benchmark_id: str, service: ServiceDependency) -> None:
    """Delete a finished benchmark with its runs and what only they refer to."""
    benchmark_store.delete_benchmark(service.database, benchmark_id)


@router.get("/{benchmark_id}/results", response_model=ResultsView, responses=CSV)
def results(
    benchmark_id: str, service: ServiceDependency, format: Literal["json", "csv"] = "json"
) -> Response:
    """The result table of all methods, after every iteration; and comparisons."""
    records = benchmark_store.runs_of(service.database, benchmark_id)
    if format == "csv":
        return Response(to_csv(table(service.outcomes(records))), media_type="text/csv")
    return Response(service.results(benchmark_id, records), media_type="application/json")


@router.get("/{benchmark_id}/claims")
def claims(benchmark_id: str, service: ServiceDependency) -> list[dict[str, Any]]:
    """What the paper claims, against this benchmark alone."""
    outcomes = service.outcomes(benchmark_store.runs_of(service.database, benchmark_id))
    return [asdict(report) for report in reports(outcomes)]


@router.get("/{benchmark_id}/cost")
def cost(benchmark_id: str, service: ServiceDependency) -> CostView:
    """What its stages cost, and how busy the cores were."""
    return service.cost(benchmark_store.runs_of(service.database, benchmark_id))


@router.get("/{benchmark_id}/figures")
def figures(benchmark_id: str, service: ServiceDependency) -> list[str]:
    """Names of the figures that can be drawn by now."""
    return drawable(service.outcomes(benchmark_store.runs_of(service.database, benchmark_id)))


@router.get("/{benchmark_id}/figures/{name}.{file_format}", response_class=Response)
def figure(
    benchmark_id: str, name: str, file_format: Format, service: ServiceDependency
) -> Response:
    """A figure, or its numbers as CSV."""
    outcomes = service.outcomes(benchmark_store.runs_of(service.database, benchmark_id))
    return Response(draw(name, outcomes, file_format), media_type=MEDIA[file_format])


def _start(service: Service, spec: BenchmarkSpec, key: str | None) -> BenchmarkRecord:
    """Store a benchmark and start its runs; where the key has started one before, that one."""
    try:
        record = benchmark_store.create_benchmark(
            service.database, spec, request_key(key, spec), service.check_queue
        )
    except Replayed as before:
        record = benchmark_store.get_benchmark(service.database, before.id)
    for run in benchmark_store.runs_of(service.database, record.id):
        if not run.is_finished:
            service.orchestrator.submit(run)
    return record


def summaries(
    service: Service, records: Sequence[BenchmarkRecord]
) -> Callable[[BenchmarkRecord], BenchmarkSummary]:
    """What shows each of these benchmarks in a list."""
    states = benchmark_store.states_of(service.database, [record.id for record in records])
    return lambda record: benchmark_summary(record, states[record.id])


def view(service: Service, record: BenchmarkRecord) -> BenchmarkView:
    runs = benchmark_store.runs_of(service.database, record.id)
    views = [run_view(run, service.orchestrator.activities(run.id)) for run in runs]
    return benchmark_view(summaries(service, [record])(record), views)

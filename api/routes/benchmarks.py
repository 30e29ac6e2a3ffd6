"""/v1/benchmarks: submit, watch, stop, resume, extend and delete grids of runs."""

from typing import Any

from fastapi import APIRouter, Response, status
from pydantic import BaseModel, SkipValidation

from adr_service.benchmark.plan import Plan
from adr_service.specs import BenchmarkSpec, RunSpec
from api.bodies import BenchmarkBody, ExtensionBody
from api.parameters import BenchmarkId, ValidateOnly
from api.routes.paging import Page, PageSize, PageToken, page_of
from api.routes.submissions import IdempotencyKey, extend_benchmark, plan_here, start_benchmark
from api.service import ServiceDependency
from api.views import BenchmarkSummary, BenchmarkView, benchmark_summaries, benchmark_view
from db import benchmarks as benchmark_store

router = APIRouter(prefix="/v1/benchmarks", tags=["benchmarks"])


class PlannedBenchmark(BaseModel):
    """Expected cost of a benchmark, and its runs."""

    spec: SkipValidation[BenchmarkSpec]
    runs: list[RunSpec]
    plan: Plan


_PLANNED: dict[int | str, Any] = {
    200: {"model": PlannedBenchmark, "description": "with `validate_only`"}
}


@router.post("", status_code=status.HTTP_202_ACCEPTED, responses=_PLANNED)
def submit(
    spec: BenchmarkBody,
    service: ServiceDependency,
    response: Response,
    validate_only: ValidateOnly = False,
    idempotency_key: IdempotencyKey = None,
) -> BenchmarkView | PlannedBenchmark:
    """Store a benchmark and start its runs; with `validate_only`, return the expected cost."""
    if validate_only:
        response.status_code = status.HTTP_200_OK
        runs = list(spec.runs())
        return PlannedBenchmark(spec=spec, runs=runs, plan=plan_here(service, runs))
    record = start_benchmark(service, spec, idempotency_key)
    response.headers["Location"] = f"/v1/benchmarks/{record.id}"
    return get_benchmark(record.id, service)


@router.get("")
def list_benchmarks(
    service: ServiceDependency, page_size: PageSize = 100, page_token: PageToken = 0
) -> Page[BenchmarkSummary]:
    """Benchmarks in order of submission, without their runs."""
    records = benchmark_store.list_benchmarks(
        service.database, after=page_token, limit=page_size + 1
    )
    page = page_of(records, page_size, lambda record: record, lambda record: record.number)
    items = benchmark_summaries(service, page.items)
    return Page(items=items, next_page_token=page.next_page_token)


@router.get("/{benchmark_id}")
def get_benchmark(benchmark_id: BenchmarkId, service: ServiceDependency) -> BenchmarkView:
    """State of a benchmark and of all its runs."""
    record = benchmark_store.get_benchmark(service.database, benchmark_id)
    return benchmark_view(service, record, benchmark_store.runs_of(service.database, benchmark_id))


@router.post("/{benchmark_id}/cancel", status_code=status.HTTP_202_ACCEPTED)
def cancel(benchmark_id: BenchmarkId, service: ServiceDependency) -> BenchmarkView:
    """Ask every live run to stop."""
    service.orchestrator.cancel(*benchmark_store.request_cancel_all(service.database, benchmark_id))
    return get_benchmark(benchmark_id, service)


@router.post("/{benchmark_id}/resume", status_code=status.HTTP_202_ACCEPTED)
def resume(benchmark_id: BenchmarkId, service: ServiceDependency) -> BenchmarkView:
    """Continue every failed or cancelled run."""
    for run in benchmark_store.resubmit_all(service.database, benchmark_id, service.check_queue):
        service.orchestrator.submit(run)
    return get_benchmark(benchmark_id, service)


@router.post("/{benchmark_id}/extend", status_code=status.HTTP_202_ACCEPTED, responses=_PLANNED)
def extend(
    benchmark_id: BenchmarkId,
    extension: ExtensionBody,
    service: ServiceDependency,
    response: Response,
    validate_only: ValidateOnly = False,
    idempotency_key: IdempotencyKey = None,
) -> BenchmarkView | PlannedBenchmark:
    """Add seeds, methods, tasks, variants or collectors; nothing is computed twice.

    With `validate_only`, return the new runs and their expected cost.
    """
    if validate_only:
        spec, runs = benchmark_store.planned_extension(service.database, benchmark_id, extension)
        response.status_code = status.HTTP_200_OK
        return PlannedBenchmark(spec=spec, runs=runs, plan=plan_here(service, runs))
    extend_benchmark(service, benchmark_id, extension, idempotency_key)
    return get_benchmark(benchmark_id, service)


@router.delete("/{benchmark_id}", status_code=status.HTTP_204_NO_CONTENT)
def delete(benchmark_id: BenchmarkId, service: ServiceDependency) -> None:
    """Delete a finished benchmark with its runs and everything that only they refer to."""
    benchmark_store.delete_benchmark(service.database, benchmark_id)

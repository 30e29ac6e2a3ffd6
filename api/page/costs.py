"""The pages that say what a run or a benchmark has cost."""

from collections.abc import Sequence

from fastapi import APIRouter, Request, Response

from adr_service.benchmark.cost import USES
from api.page.rendering import show
from api.results import cost_of
from api.service import Service, ServiceDependency
from db import benchmarks as benchmark_store
from db import runs as run_store
from db.runs import RunRecord

router = APIRouter(include_in_schema=False)


@router.get("/runs/{run_id}/cost")
def run_cost(run_id: str, request: Request, service: ServiceDependency) -> Response:
    return _page(request, service, run_id, [run_store.get_run(service.database, run_id)])


@router.get("/benchmarks/{benchmark_id}/cost")
def benchmark_cost(benchmark_id: str, request: Request, service: ServiceDependency) -> Response:
    records = benchmark_store.runs_of(service.database, benchmark_id)
    return _page(request, service, benchmark_id, records)


def _page(request: Request, service: Service, id: str, records: Sequence[RunRecord]) -> Response:
    """The cost as tables, with a link to the same as JSON."""
    return show(
        request,
        "cost.html",
        id=id,
        page=request.url.path.removesuffix("/cost"),
        json=f"/v1{request.url.path}",
        cost=cost_of(service, records),
        uses=USES,
    )

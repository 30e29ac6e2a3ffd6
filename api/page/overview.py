"""The first page: what runs, what waits, and the newest benchmarks and runs."""

import json
import logging
import time
from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse

from adr_service.errors import InvalidInput
from adr_service.methods.catalogue import methods
from api.page.names import titles
from api.page.rendering import SEE_OTHER, show
from api.results import results_json
from api.service import Service, ServiceDependency
from api.views import BenchmarkSummary, benchmark_summaries
from db import benchmarks as benchmark_store
from db import visits as visit_store
from db.errors import DatabaseUnavailable
from db.models import OPEN_VISIT

router = APIRouter(include_in_schema=False)
_SHOWN = 50  # of each list; the API has the rest
_MOST_ACTIVITIES = 20
_MOST_VISITS = 1000  # that are counted
_PATIENCE_S = 2.0  # for comparisons of benchmarks, which take seconds each once
log = logging.getLogger(__name__)


@router.get("/benchmarks")
@router.get("/runs")
def lists() -> Response:
    """The lists of both are on the first page."""
    return RedirectResponse("/", SEE_OTHER)


@router.get("/")
def overview(request: Request, service: ServiceDependency) -> Response:
    records, single = benchmark_store.latest(service.database, _SHOWN)
    benchmarks = benchmark_summaries(service, records)
    activities, leaders = service.orchestrator.activities(), _leaders(service, benchmarks)
    visits = visit_store.list_visits(
        service.database, states=OPEN_VISIT, external=True, limit=_MOST_VISITS
    )
    shown, now = activities[:_MOST_ACTIVITIES], service.orchestrator.clock.now()
    # one whose lease has ended is free for another robot
    waiting = [visit for visit in visits if visit.expires_at is None or visit.expires_at <= now]
    return show(
        request,
        "overview.html",
        # unfinished benchmarks have no leader, and between two stages a run has no activity
        live=bool(activities)
        or len(leaders) < len(benchmarks)
        or not all(run.is_finished for run in single),
        cores=service.orchestrator.cores,
        free_disk=service.free_disk(),
        ray=service.dashboard_url,
        robots=len(waiting),
        activities=activities,
        shown=shown,
        owners=titles(service, (each.started_by for each in shown)),
        benchmarks=benchmarks,
        leaders=leaders,
        runs=single,
    )


def _leaders(
    service: Service, benchmarks: Sequence[BenchmarkSummary]
) -> dict[str, dict[str, Any] | None]:
    """The best methods of finished benchmarks; nothing is compared while results still come.

    They are kept until a run changes, because a page that renews itself must be cheap. Those that
    a look has no time to compare, or that others compare just now, are missing: the next one has
    them.
    """
    until = time.monotonic() + _PATIENCE_S
    finished = [benchmark.id for benchmark in benchmarks if benchmark.is_finished]
    # an import that was interrupted may have stored a benchmark without its runs
    found: dict[str, dict[str, Any] | None] = {b.id: None for b in benchmarks if not b.states}
    for id, changed in benchmark_store.changes_of(service.database, finished).items():
        before = service.leaders.get(id)
        if before is None or before[0] != changed:
            if service.comparing[id].locked() or time.monotonic() > until:
                continue
            before = service.leaders[id] = (changed, _leader(service, id))
        found[id] = before[1]
    return found


def _leader(service: Service, id: str) -> dict[str, Any] | None:
    runs = benchmark_store.runs_of(service.database, id)
    try:
        found = json.loads(results_json(service, id, runs))["aggregates"]
    except InvalidInput as error:  # an imported run without its results may have any events
        log.warning("%s has no table: %s", id, error)
        found = []
    except DatabaseUnavailable:  # which passes: the next visitor asks again
        raise
    except Exception:  # whatever is wrong with this one, the others are to be seen
        log.exception("%s has no table", id)
        found = []
    # a stored table outlives the package of a method
    kinds = ((row, methods().get(row["method"])) for row in found)
    ranked = [row for row, kind in kinds if kind is not None and not kind.is_reference]
    return max(ranked, key=lambda row: row["mean"], default=None)

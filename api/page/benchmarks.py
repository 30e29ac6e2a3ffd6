"""The pages of one benchmark and of several side by side."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Form, Query, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from pydantic import ValidationError

from adr_service.benchmark.budgets import changes
from adr_service.benchmark.claims import reports
from adr_service.benchmark.comparison import Outcome, final_outcomes, lost, not_compared, table
from adr_service.benchmark.figures import CAPTIONS, drawable
from adr_service.benchmark.improvements import improvement_matrices
from adr_service.errors import InvalidInput
from adr_service.json_values import explain
from adr_service.methods.catalogue import methods, names_of
from adr_service.specs import BenchmarkExtension, RunSpec
from api.durations import in_words
from api.page.names import apart_of, numbers_in, titles
from api.page.rendering import SEE_OTHER, show
from api.results import cautions_of, outcomes_of, results_json
from api.routes import benchmarks as routes
from api.routes.submissions import price
from api.service import Service, ServiceDependency
from api.views import BenchmarkView, benchmark_view
from db import benchmarks as benchmark_store
from db import runs as run_store
from db.errors import NotFound
from db.runs import RunRecord

router = APIRouter(include_in_schema=False)
_MOST_COMPARED = 50
Json = dict[str, Any]


@router.get("/benchmarks/{benchmark_id}")
def benchmark(benchmark_id: str, request: Request, service: ServiceDependency) -> Response:
    records = benchmark_store.runs_of(service.database, benchmark_id)
    record = benchmark_store.get_benchmark(service.database, benchmark_id)
    shown = benchmark_view(service, record, records)
    outcomes = outcomes_of(service, records)
    working = [stage for run in shown.runs for stage in run.progress]
    working = list({stage.digest: stage for stage in working}.values())  # runs share stages
    return show(
        request,
        "benchmark.html",
        live=not shown.is_finished,
        benchmark=shown,
        working=working,
        owners=titles(service, (stage.started_by for stage in working)),
        ray=service.dashboard_url,
        offline=names_of("recordings"),
        figures=drawable(outcomes),
        captions=CAPTIONS,
        iterations=len(outcomes),
        is_guarded=bool(service.settings.token.get_secret_value()),
        spec=json.dumps(shown.spec.model_dump(mode="json", exclude_unset=True), indent=1),
        **_tables(service, shown, records, outcomes),
    )


def _tables(
    service: Service, shown: BenchmarkView, records: Sequence[RunRecord], outcomes: list[Outcome]
) -> Json:
    """The tables. Bootstraps take a moment: not at every refresh of what changes anyway."""
    if shown.is_finished:
        found = json.loads(results_json(service, shown.id, records))
        rows, aggregates, cautions = found["rows"], found["aggregates"], found["cautions"]
        matrices = improvement_matrices(found["comparisons"])
        claims = [asdict(report) for report in reports(outcomes)]
    else:
        rows, aggregates, matrices, claims = _rows(outcomes), [], [], []
        cautions = lost(outcomes)
    final = final_rows(rows, outcomes)
    return {
        "cautions": cautions,
        "rows": rows,
        "final": final,
        "not_compared": not_compared(outcomes),
        "best": best_of(final),
        "aggregates": sorted(aggregates, key=lambda each: -each["mean"]),
        "matrices": matrices,
        "claims": claims,
    }


def _rows(outcomes: Sequence[Outcome]) -> list[Json]:
    return [asdict(row) for row in table(outcomes)]


def final_rows(rows: Sequence[Json], outcomes: Sequence[Outcome]) -> list[Json]:
    """The row of each method on each task's variant and data that is compared, the best first."""
    compared = {
        (spec.task, spec.variant, spec.method.name, spec.collector, found[0].iteration.iteration)
        for columns in final_outcomes(outcomes).values()
        for found in columns.values()
        for spec in [found[0].spec]
    }
    names = ("task", "variant", "method", "collector", "iteration")
    final = [row for row in rows if tuple(row[name] for name in names) in compared]
    return sorted(final, key=lambda row: (row["task"], row["variant"], -row["normalised_return"]))


def best_of(final: Sequence[Json]) -> list[Json]:
    """The best row of each task's variant, of the methods that have an interval; no references."""
    best: dict[tuple[str, str], Json] = {}
    for row in final:
        method = methods().get(row["method"])
        if method is None or method.is_reference:  # a stored table outlives a method's package
            continue
        if row["low"] is not None:
            best.setdefault((row["task"], row["variant"]), row)
    return list(best.values())


@router.get("/benchmarks/{benchmark_id}/left")
def left(benchmark_id: str, service: ServiceDependency) -> Response:
    """A sentence on the work that is left; its price takes seconds for a large benchmark."""
    records = benchmark_store.runs_of(service.database, benchmark_id)
    live = [r.spec for r in records if not r.is_finished and isinstance(r.spec, RunSpec)]
    plan = price(service, live)  # also of methods that are installed elsewhere
    if not live or plan.hours is None:
        return HTMLResponse("")
    return HTMLResponse(
        f"At most {in_words(plan.hours)} left on {plan.cores} cores "
        f"({in_words(plan.core_hours)} of computing), if every training uses all its steps."
    )


@router.post("/benchmarks/{benchmark_id}/cancel")
def cancel(benchmark_id: str, service: ServiceDependency) -> Response:
    routes.cancel(benchmark_id, service)
    return RedirectResponse(f"/benchmarks/{benchmark_id}", SEE_OTHER)


@router.post("/benchmarks/{benchmark_id}/resume")
def resume(benchmark_id: str, service: ServiceDependency) -> Response:
    routes.resume(benchmark_id, service)
    return RedirectResponse(f"/benchmarks/{benchmark_id}", SEE_OTHER)


@router.post("/benchmarks/{benchmark_id}/extend")
def extend(
    benchmark_id: str, service: ServiceDependency, seeds: Annotated[str, Form(max_length=1000)]
) -> Response:
    try:
        extension = BenchmarkExtension.model_validate({"seeds": numbers_in(seeds)})
    except ValidationError as error:
        raise InvalidInput(explain(error, "the extension")) from error
    routes.extend(benchmark_id, extension, service, Response())
    return RedirectResponse(f"/benchmarks/{benchmark_id}", SEE_OTHER)


@router.get("/compare")
def compare(
    request: Request,
    service: ServiceDependency,
    id: Annotated[list[str] | None, Query()] = None,
) -> Response:
    """Benchmarks and runs side by side; an address may have several ids in one parameter."""
    given = " ".join(id or []).replace(",", " ").split()
    ids = list(dict.fromkeys(given))
    if len(ids) > _MOST_COMPARED:
        raise InvalidInput(f"{len(ids)} ids are too many to compare; accepted are {_MOST_COMPARED}")
    rows: list[tuple[str, str, Json]] = []
    without: list[str] = []
    left: list[str] = []
    cautions: list[str] = []
    for each in ids:
        try:
            records = _runs_of(service, each)
        except NotFound as error:
            cautions.append(str(error))
            continue
        outcomes = outcomes_of(service, records)
        final = final_rows(_rows(outcomes), outcomes)
        without += [] if final else [each]
        left += [f"{column} of {each}" for column in not_compared(outcomes)]
        cautions += [f"{each}: {told}" for told in cautions_of(service, records, outcomes)]
        rows += [(each, experiment_of(row, outcomes), row) for row in final]
    rows.sort(key=lambda row: (row[2]["task"], row[2]["variant"], row[2]["method"]))
    return show(
        request,
        "compare.html",
        ids=ids,
        rows=rows,
        without=without,
        not_compared=left,
        cautions=cautions,
    )


def experiment_of(row: Json, outcomes: Sequence[Outcome]) -> str:
    """The preset of a row's runs, with what they have set otherwise, and with an unusual target."""
    column = ("task", "variant", "collector")
    own = [
        outcome
        for outcome in outcomes
        if outcome.spec.method.name == row["method"]
        and all(getattr(outcome.spec, name) == row[name] for name in column)
    ]
    changed = [f"{name} = {value}" for name, value in changes(own).items()]
    return ", ".join([own[0].spec.preset, *changed]) + apart_of(own[0].spec)


def _runs_of(service: Service, id: str) -> list[RunRecord]:
    if id.startswith("bench_"):
        return benchmark_store.runs_of(service.database, id)
    return [run_store.get_run(service.database, id)]

"""Results and costs of runs, as the API answers them."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from itertools import groupby
from operator import itemgetter
from typing import Any

from pydantic import BaseModel

import adr_service
from adr_service.benchmark.aggregate import Aggregate, aggregates
from adr_service.benchmark.comparison import (
    Comparison,
    InferenceCost,
    Outcome,
    ParameterEstimate,
    Row,
    comparisons,
    costs,
    estimates,
    lost,
    not_compared,
    table,
)
from adr_service.benchmark.cost import Execution, Utilisation, utilisation
from adr_service.events import IterationFinished, RunState
from adr_service.json_values import canonical_json, sha256
from adr_service.plugins import TASKS, other_versions, package_of
from adr_service.specs import AnyRun, LostRun, RecordedTarget, RunSpec
from adr_service.specs.lost import reason_of_distributions
from api.service import Service
from db import events as event_store
from db import results as result_store
from db import stages as stage_store
from db.errors import DatabaseUnavailable
from db.runs import RunRecord

log = logging.getLogger(__name__)
_TABLES = 9  # counts the times that tables of the same outcomes changed
_COST_NOTE = (
    "the use of the cores counts all that the service computed while there was work for all of "
    "them, other runs' stages too, and no more; useful = computing / (computing + waiting + "
    "orchestration), overhead = orchestration / all; known when the runs have finished, for the "
    "time in which their stages were computed here"
)


class ResultsView(BaseModel):
    """The result table; `note` says what a reader must know of it."""

    note: str
    # the end of the note: what cannot be read here, and versions that rows may mix
    cautions: list[str]
    rows: list[dict[str, Any]]
    aggregates: list[dict[str, Any]]  # methods over all tasks and variants that all of them have
    comparisons: list[dict[str, Any]]  # differences and probabilities of improvement, by pair
    # methods with too few seeds to be compared, and where: "bayrn (hopper noisy)"
    not_compared: list[str]
    estimates: list[dict[str, Any]]  # by parameter, of methods that infer
    costs: list[dict[str, Any]]  # of the inferences


class KindCost(BaseModel):
    """All stages of a kind, each counted once."""

    kind: str
    stages: int
    seconds: float  # on a core
    cpu_seconds: float
    preparing_seconds: float  # imports by the CPU's clock, compilations by JAX's


class CostView(BaseModel):
    """Cost of a run or a benchmark so far. Stages shared with others are included."""

    note: str
    kinds: list[KindCost]
    # null: it has not finished, none of it was computed here, or there was never work for all cores
    # at once
    utilisation: Utilisation | None
    inferences: list[dict[str, Any]]


def outcomes_of(service: Service, records: Sequence[RunRecord]) -> list[Outcome]:
    """Return the finished iterations of runs, with the seconds that their inference took."""
    specs = {record.id: record.spec for record in records}
    failed = set(_failed(records))
    iterations = [
        (run_id, spec, event)
        for run_id, event in event_store.all_of(service.database, list(specs), IterationFinished)
        if isinstance(spec := specs[run_id], RunSpec)
    ]
    digests = [digest for _, _, event in iterations for digest in event.inferences]
    seconds, reasons = stage_store.cpu_seconds_of(service.database, digests), _lost(service, specs)
    return [
        Outcome(
            spec,
            event,
            _seconds(seconds, event.inferences),
            reasons.get(run_id),
            run_id in failed,
        )
        for run_id, spec, event in iterations
    ]


def _failed(records: Sequence[RunRecord]) -> list[str]:
    """The ids of the runs that have failed."""
    return [record.id for record in records if record.state == RunState.FAILED]


def _lost(service: Service, specs: Mapping[str, AnyRun | LostRun]) -> dict[str, str]:
    """The reasons by run, for those computed with another version of their task's package."""
    packaged = [run_id for run_id, spec in specs.items() if package_of(TASKS, spec.task)]
    return {
        run_id: reason_of_distributions(other)
        for run_id, inputs in stage_store.packaged_inputs(service.database, packaged)
        if (other := other_versions(inputs).get("package"))
    }


def _seconds(known: Mapping[str, float], digests: Sequence[str]) -> float | None:
    """The seconds of stages together; None for none, or if one of them was not measured."""
    if not digests or not known.keys() >= set(digests):
        return None
    return sum(known[digest] for digest in digests)


def results_json(service: Service, id: str, records: Sequence[RunRecord]) -> str:
    """Return the ResultsView of a run or a benchmark as JSON.

    Its bootstraps take seconds, so it is stored until one of the runs finishes another iteration,
    fails or goes on, tables have other columns, or a task's package has another version. Whoever
    asks for one that is computed just now waits for it.
    """
    count = event_store.count_iterations(service.database, [record.id for record in records])
    tables = (Row, Aggregate, Comparison, ParameterEstimate, InferenceCost)
    columns = [field.name for each in tables for field in fields(each)]
    unread = [record.id for record in records if isinstance(record.spec, LostRun)]
    tasks = sorted({record.spec.task for record in records})
    packages = [package_of(TASKS, task) for task in tasks]
    known = [adr_service.__version__, _TABLES, columns, count, unread, packages, _failed(records)]
    version = sha256(canonical_json(known).encode())
    if (stored := result_store.kept_results(service.database, id, version)) is not None:
        return stored
    with service.comparing[id]:
        if (stored := result_store.kept_results(service.database, id, version)) is not None:
            return stored
        outcomes = outcomes_of(service, records)
        view = _results_view(outcomes, cautions_of(service, records, outcomes))
        results = view.model_dump_json()
        try:
            result_store.keep_results(service.database, id, version, results)
        except DatabaseUnavailable as error:
            log.warning("the results of %s are not kept: %s", id, error)
    return results


def cautions_of(
    service: Service, records: Sequence[RunRecord], outcomes: Sequence[Outcome]
) -> list[str]:
    """Warnings of runs that cannot be read here, and of rows that may mix versions."""
    cautions = lost(outcomes)
    if unread := sum(isinstance(record.spec, LostRun) for record in records):
        cautions.append(f"runs that cannot be read here, and are left out: {unread}")
    if mixed := _mixed(service, records):
        cautions.append(f"rows may mix versions: {mixed}")
    return cautions


def _mixed(service: Service, records: Sequence[RunRecord]) -> str:
    """The kinds of stages and the packages that the runs have in several versions, for a note."""
    with service.database.read() as session:
        found = stage_store.versions_of(session, [record.id for record in records])
    named = [
        (name, [version for _, version in versions])
        for group in (found.kinds, found.packages)
        for name, versions in groupby(sorted(group), key=itemgetter(0))
    ]
    several = (f"{name} {' and '.join(them)}" for name, them in named if len(them) > 1)
    return ", ".join(several)


def _results_view(outcomes: Sequence[Outcome], cautions: Sequence[str]) -> ResultsView:
    """Return tables of finished iterations, and a note on how to read them."""
    return ResultsView(
        note="; ".join([_note(outcomes), *cautions]),
        cautions=list(cautions),
        rows=[asdict(row) for row in table(outcomes)],
        aggregates=[asdict(each) for each in aggregates(outcomes)],
        comparisons=[asdict(pair) for pair in comparisons(outcomes)],
        not_compared=not_compared(outcomes),
        estimates=[asdict(estimate) for estimate in estimates(outcomes)],
        costs=[asdict(cost) for cost in costs(outcomes)],
    )


def _note(outcomes: Sequence[Outcome]) -> str:
    if any(outcome.spec.preset == "smoke" for outcome in outcomes):
        return "preset 'smoke': tiny searches and trainings; these numbers mean nothing"
    if outcomes and all(isinstance(outcome.spec.target, RecordedTarget) for outcome in outcomes):
        return "a recorded target: there is nothing to evaluate the policy on"
    return "undiscounted target return / reward threshold; 95 % interval over seeds"


def cost_of(service: Service, records: Sequence[RunRecord]) -> CostView:
    """Return the cost of runs so far."""
    ids = [record.id for record in records]
    executions = stage_store.executions_of(service.database, ids)
    used = None
    here = stage_store.executions_of(service.database, ids, only_here=True)
    if here and all(record.is_finished for record in records):
        used = _utilisation(service, [execution for _, execution in here])
    return cost_view(executions, used, outcomes_of(service, records))


def _utilisation(service: Service, executions: Sequence[Execution]) -> Utilisation | None:
    """Return the utilisation of the cores from the first of these stages to the last."""
    first = min(execution.asked for execution in executions)
    last = max(execution.ended for execution in executions)
    # stages of other runs keep cores busy too
    return utilisation(stage_store.executions_between(service.database, first, last))


def cost_view(
    executions: Sequence[tuple[str, Execution]],
    used: Utilisation | None,
    outcomes: Sequence[Outcome],
) -> CostView:
    """Return the cost of stages, given as (kind, execution)."""
    kinds: dict[str, list[Execution]] = {}
    for kind, execution in executions:
        kinds.setdefault(kind, []).append(execution)
    return CostView(
        note=_COST_NOTE,
        kinds=[_kind_cost(kind, group) for kind, group in sorted(kinds.items())],
        utilisation=used,
        inferences=[asdict(cost) for cost in costs(outcomes)],
    )


def _kind_cost(kind: str, executions: Sequence[Execution]) -> KindCost:
    return KindCost(
        kind=kind,
        stages=len(executions),
        seconds=sum(execution.seconds for execution in executions),
        cpu_seconds=sum(execution.cpu or 0.0 for execution in executions),
        preparing_seconds=sum(execution.preparing or 0.0 for execution in executions),
    )

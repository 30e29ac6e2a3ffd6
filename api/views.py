"""Runs and benchmarks as the API answers them: domain values with their links."""

from collections.abc import Mapping, Sequence
from datetime import datetime

from pydantic import BaseModel, SkipValidation

from adr_service.events import FINISHED, RunState
from adr_service.specs import BenchmarkSpec, CriticismSpec, LostBenchmark, LostRun, RunSpec
from api.service import Service
from db import benchmarks as benchmark_store
from db.benchmarks import BenchmarkRecord
from db.runs import RunRecord
from workers.jobs import Activity


class RunError(BaseModel):
    code: str
    message: str


class RunView(BaseModel):
    id: str
    benchmark_id: str | None
    state: RunState
    cancel_requested: bool
    submission: int
    created_at: datetime
    updated_at: datetime
    error: RunError | None
    progress: list[Activity]
    # it is valid, and checking a benchmark takes a while
    spec: SkipValidation[RunSpec | CriticismSpec | LostRun]
    links: dict[str, str]


class BenchmarkSummary(BaseModel):
    """A benchmark in a list."""

    id: str
    created_at: datetime
    states: dict[str, int]
    is_finished: bool
    spec: SkipValidation[BenchmarkSpec | LostBenchmark]
    links: dict[str, str]


class BenchmarkView(BenchmarkSummary):
    runs: list[RunView]


def run_view(service: Service, record: RunRecord) -> RunView:
    """Return a run with the stages that it waits for now."""
    is_running = record.state == RunState.RUNNING  # the others wait for no stage
    error = None
    if record.error_code is not None:
        error = RunError(code=record.error_code, message=record.error_message or "")
    return RunView(
        id=record.id,
        benchmark_id=record.benchmark_id,
        state=record.state,
        cancel_requested=record.cancel_requested,
        submission=record.submission,
        created_at=record.created_at,
        updated_at=record.updated_at,
        error=error,
        progress=service.orchestrator.activities(record.id) if is_running else [],
        spec=record.spec,
        links=_run_links(record),
    )


def _run_links(record: RunRecord) -> dict[str, str]:
    here = f"/v1/runs/{record.id}"
    links = {"self": here, "events": f"{here}/events", "cost": f"{here}/cost"}
    if isinstance(record.spec, CriticismSpec):
        return {**links, "criticism": f"/v1/criticisms/{record.id}"}
    own = ("results", "policy", "distribution", "trainings")
    return {**links, **{name: f"{here}/{name}" for name in own}}


def benchmark_view(
    service: Service, record: BenchmarkRecord, runs: Sequence[RunRecord]
) -> BenchmarkView:
    """Return a benchmark with all its runs."""
    (summary,) = benchmark_summaries(service, [record])
    return BenchmarkView(**dict(summary), runs=[run_view(service, run) for run in runs])


def benchmark_summaries(
    service: Service, records: Sequence[BenchmarkRecord]
) -> list[BenchmarkSummary]:
    """Return benchmarks without their runs; one query counts the states of all."""
    states = benchmark_store.states_of(service.database, [record.id for record in records])
    return [_summary(record, states[record.id]) for record in records]


def _summary(record: BenchmarkRecord, states: Mapping[str, int]) -> BenchmarkSummary:
    """`states` are the numbers of its runs in each state."""
    here = f"/v1/benchmarks/{record.id}"
    return BenchmarkSummary(
        id=record.id,
        created_at=record.created_at,
        states=dict(states),
        is_finished=set(states) <= FINISHED,
        spec=record.spec,
        links={
            "self": here,
            "page": f"/benchmarks/{record.id}",
            "results": f"{here}/results",
            "csv": f"{here}/results?format=csv",
            "figures": f"{here}/figures",
            "claims": f"{here}/claims",
            "cost": f"{here}/cost",
        },
    )

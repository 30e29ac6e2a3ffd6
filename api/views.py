"""What the API answers: domain values with their links."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, SkipValidation

from adr_service.benchmark.comparison import Outcome, comparisons, costs, decode, estimates, table
from adr_service.benchmark.cost import Execution, Utilisation
from adr_service.benchmark.protocol import Plan
from adr_service.events import (
    FINISHED,
    CriticismFinished,
    RunEvent,
    RunState,
    StageFinished,
    TrainingEvaluated,
)
from adr_service.specs import BenchmarkSpec, CriticismSpec, RecordedTarget, RunSpec
from adr_service.tasks.catalogue import get_task
from db.benchmarks import BenchmarkRecord
from db.datasets import DatasetRecord
from db.events import EventRecord
from db.models import VisitState
from db.runs import RunRecord
from db.visits import Visit
from workers.jobs import Activity

Item = TypeVar("Item")
Record = TypeVar("Record")
_COST_NOTE = (
    "core seconds of everything the service computed while there was work for all cores; useful = "
    "computing / (computing + waiting + orchestration), overhead = orchestration / all; told when "
    "the runs have finished"
)


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
    spec: SkipValidation[
        RunSpec | CriticismSpec
    ]  # it is valid, and checking a benchmark takes a while
    links: dict[str, str]


class BenchmarkSummary(BaseModel):
    """A benchmark in a list."""

    id: str
    created_at: datetime
    states: dict[str, int]
    is_finished: bool
    spec: SkipValidation[BenchmarkSpec]
    links: dict[str, str]


class BenchmarkView(BenchmarkSummary):
    runs: list[RunView]


class PlannedRun(BaseModel):
    """What a run would cost."""

    spec: RunSpec
    plan: Plan


class PlannedBenchmark(BaseModel):
    """What a benchmark would cost, and its runs."""

    spec: SkipValidation[BenchmarkSpec]
    runs: list[RunSpec]
    plan: Plan


class EventView(BaseModel):
    seq: int
    created_at: datetime
    event: RunEvent


class Page(BaseModel, Generic[Item]):
    """A page of a list; `next_page_token` is null on the last."""

    items: list[Item]
    next_page_token: str | None


class ResultsView(BaseModel):
    """The result table; `note` says what a reader must know of it."""

    note: str
    rows: list[dict[str, Any]]
    comparisons: list[dict[str, Any]]  # probabilities of improvement, of every pair of methods
    estimates: list[dict[str, Any]]  # by parameter, of methods that infer
    costs: list[dict[str, Any]]  # of the inferences


class KindCost(BaseModel):
    """All stages of a kind, each counted once."""

    kind: str
    stages: int
    seconds: float  # on a core
    cpu_seconds: float
    preparing_seconds: float  # imports and compilations, by the clock


class CostView(BaseModel):
    """What was spent on a run or a benchmark. Stages shared with others are included."""

    note: str
    kinds: list[KindCost]
    # null: it has not finished, or there was never work for all cores at once
    utilisation: Utilisation | None
    inferences: list[dict[str, Any]]


class CurvePoint(BaseModel):
    steps: int
    mean_return: float  # on the source distribution
    standard_error: float


class TrainingView(BaseModel):
    """A policy's training, finished or not."""

    digest: str
    is_finished: bool
    curve: list[CurvePoint]
    links: dict[str, str]


class CriticismView(BaseModel):
    """A criticism: the run that it is, and its verdict as soon as there is one."""

    run: RunView
    verdict: dict[str, Any] | None  # as `adr criticise` writes it
    links: dict[str, str]


class DatasetView(DatasetRecord):
    """A stored recording, with its links."""

    links: dict[str, str]


class TaskView(BaseModel):
    """A visit to a target: an episode that somebody has, had, or may claim."""

    id: str
    run_id: str
    task: str
    kind: str  # of the episode: rollout, return, evaluation; else of the stage
    number: int
    transitions: int  # at most
    seed: int
    has_policy: bool  # else random actions
    external: bool
    state: VisitState
    attempt: int
    worker: str | None
    steps: int
    claimed_at: datetime | None
    lease_expires_at: datetime | None
    error: str | None
    created_at: datetime
    links: dict[str, str]


class ClaimView(BaseModel):
    """A task for a robot, and the lease that everything said of it must carry."""

    task: TaskView
    lease: str
    lease_s: float  # from now on, or from the last heartbeat


class HeartbeatView(BaseModel):
    lease_expires_at: datetime
    cancel_requested: bool  # stop moving, and release the task


class ParameterView(BaseModel):
    name: str
    address: str  # in the model
    unit: str
    mean: list[float]  # one per distribution
    std: list[float]


class DistributionView(BaseModel):
    """What policies were trained on; several distributions for UDR alone."""

    task: str
    variant: str
    method: str
    iteration: int
    parameters: list[ParameterView]
    distributions: list[dict[str, Any]]
    diagnostics: dict[str, Any]  # of the inference


def run_view(record: RunRecord, activities: Sequence[Activity]) -> RunView:
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
        progress=list(activities),
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


def criticism_view(run: RunView, finished: CriticismFinished | None) -> CriticismView:
    here = f"/v1/criticisms/{run.id}"
    files = {} if finished is None else {name: f"{here}/{name}" for name in finished.files}
    return CriticismView(
        run=run,
        verdict=None if finished is None else finished.verdict,
        links={"self": here, "run": run.links["self"], **files},
    )


def benchmark_view(summary: BenchmarkSummary, runs: Sequence[RunView]) -> BenchmarkView:
    return BenchmarkView(**dict(summary), runs=list(runs))


def benchmark_summary(record: BenchmarkRecord, states: Mapping[str, int]) -> BenchmarkSummary:
    """`states` are the numbers of its runs in each."""
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


def page_of(
    found: Sequence[Record],
    size: int,
    render: Callable[[Record], Item],
    position: Callable[[Record], int],
) -> Page[Item]:
    """A page of `size` items, from a query that asked for one more."""
    shown = found[:size]
    token = str(position(shown[-1])) if len(found) > size else None
    return Page(items=[render(record) for record in shown], next_page_token=token)


def task_view(task: Visit) -> TaskView:
    here, inputs = f"/v1/target_tasks/{task.id}", task.inputs
    return TaskView(
        id=task.id,
        run_id=task.run_id,
        task=task.task,
        kind=inputs.get("purpose", task.kind),
        number=inputs.get("number", inputs.get("iteration", 0)),
        transitions=inputs.get("transitions", get_task(task.task).horizon),
        seed=inputs["seed"],
        has_policy=task.has_policy,
        external=task.external,
        state=task.state,
        attempt=task.attempt,
        worker=task.worker,
        steps=task.steps,
        claimed_at=task.claimed_at,
        lease_expires_at=task.expires_at,
        error=task.error,
        created_at=task.created_at,
        links={
            "self": here,
            "run": f"/v1/runs/{task.run_id}",
            **({"policy": f"{here}/policy"} if task.has_policy else {}),
        },
    )


def claim_view(task: Visit) -> ClaimView:
    assert task.lease is not None
    assert task.expires_at is not None
    assert task.claimed_at is not None
    lease_s = (task.expires_at - task.claimed_at).total_seconds()
    return ClaimView(task=task_view(task), lease=task.lease, lease_s=lease_s)


def event_view(record: EventRecord) -> EventView:
    return EventView(seq=record.seq, created_at=record.created_at, event=record.event)


def results_view(outcomes: Sequence[Outcome]) -> ResultsView:
    note = "undiscounted target return / reward threshold; 95 % bootstrap interval"
    if outcomes and all(isinstance(outcome.spec.target, RecordedTarget) for outcome in outcomes):
        note = "a recorded target: there is nothing to evaluate the policy on"
    if any(outcome.spec.preset == "smoke" for outcome in outcomes):
        note = "preset 'smoke': a few hundred training steps; these numbers mean nothing"
    return ResultsView(
        note=note,
        rows=[asdict(row) for row in table(outcomes)],
        comparisons=[asdict(pair) for pair in comparisons(outcomes)],
        estimates=[asdict(estimate) for estimate in estimates(outcomes)],
        costs=[asdict(cost) for cost in costs(outcomes)],
    )


def cost_view(
    executions: Sequence[tuple[str, Execution]],
    used: Utilisation | None,
    outcomes: Sequence[Outcome],
) -> CostView:
    kinds: dict[str, list[Execution]] = {}
    for kind, execution in executions:
        kinds.setdefault(kind, []).append(execution)
    return CostView(
        note=_COST_NOTE,
        kinds=[
            KindCost(
                kind=kind,
                stages=len(group),
                seconds=sum(e.seconds for e in group),
                cpu_seconds=sum(e.cpu or 0.0 for e in group),
                preparing_seconds=sum(e.preparing or 0.0 for e in group),
            )
            for kind, group in sorted(kinds.items())
        ],
        utilisation=used,
        inferences=[asdict(cost) for cost in costs(outcomes)],
    )


def training_views(run_id: str, records: Sequence[EventRecord]) -> list[TrainingView]:
    """The trainings of a run, in the order of their first evaluation."""
    curves: dict[str, list[CurvePoint]] = {}
    finished: set[str] = set()
    for event in (record.event for record in records):
        if isinstance(event, TrainingEvaluated):
            point = event.model_dump(include=set(CurvePoint.model_fields))
            curves.setdefault(event.digest, []).append(CurvePoint(**point))
        elif isinstance(event, StageFinished):
            finished.add(event.digest)
    return [
        TrainingView(
            digest=digest,
            is_finished=digest in finished,
            curve=sorted(curve, key=lambda point: point.steps),
            links={"policy": f"/v1/runs/{run_id}/trainings/{digest}/policy"},
        )
        for digest, curve in curves.items()
    ]


def dataset_view(record: DatasetRecord) -> DatasetView:
    here = f"/v1/datasets/{record.id}"
    return DatasetView(**dict(record), links={"self": here, "content": f"{here}/content"})


def distribution_view(outcome: Outcome) -> DistributionView:
    spec, distributions = outcome.spec, decode(outcome)
    return DistributionView(
        task=spec.task,
        variant=spec.variant,
        method=spec.column,
        iteration=outcome.iteration.iteration,
        parameters=[
            ParameterView(
                name=parameter.name,
                address=parameter.address,
                unit=parameter.unit,
                mean=[float(distribution.mean[i]) for distribution in distributions],
                std=[float(distribution.std[i]) for distribution in distributions],
            )
            for i, parameter in enumerate(distributions[0].space.parameters)
        ],
        distributions=list(outcome.iteration.distributions),
        diagnostics=outcome.iteration.diagnostics,
    )

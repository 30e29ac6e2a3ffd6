"""The page of one run."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, cast

from fastapi import APIRouter, Form, Request, Response
from fastapi.responses import RedirectResponse
from pydantic import BaseModel, ValidationError

from adr_service.benchmark.comparison import estimates, lost, table
from adr_service.benchmark.cost import Execution
from adr_service.benchmark.figures import CAPTIONS, drawable
from adr_service.criticism.verdict import interval_text, quantity_text
from adr_service.effects.catalogue import MECHANISMS
from adr_service.errors import InvalidInput, remedy_of
from adr_service.events import (
    CriticismFinished,
    IterationFinished,
    RunEvent,
    RunFailed,
    StageFinished,
    TrainingEvaluated,
)
from adr_service.json_values import explain
from adr_service.methods.base import Grid
from adr_service.methods.catalogue import methods
from adr_service.presets import PRESETS
from adr_service.specs import RunSpec
from api.durations import in_words
from api.page.names import title_of
from api.page.rendering import SEE_OTHER, show
from api.results import outcomes_of
from api.routes import criticisms
from api.routes import runs as routes
from api.routes.criticisms import criticism_view
from api.routes.submissions import start_run
from api.routes.target_tasks import task_view
from api.routes.trainings import training_views
from api.service import ServiceDependency
from api.specs import effects_of
from api.verdicts import told
from api.views import run_view
from db import events as event_store
from db import runs as run_store
from db import stages as stage_store
from db import visits as visit_store
from db.models import OPEN_VISIT

router = APIRouter(include_in_schema=False)
_MOST_BARS = 80
_VISITS = 10  # that wait for a robot and are shown


@dataclass(frozen=True)
class Part:
    """A stretch of a stage's time; start and width are shares of the whole."""

    name: str
    start: float
    width: float


@dataclass(frozen=True)
class Bar:
    """A stage's time: it waited, a process started, and it was computed."""

    kind: str
    parts: list[Part]
    seconds: float  # of computing


@dataclass(frozen=True)
class Timeline:
    """The stages of a run in the order in which they were asked for."""

    bars: list[Bar]
    span: str
    left_out: int


@router.get("/runs/{run_id}")
def run(run_id: str, request: Request, service: ServiceDependency) -> Response:
    record = run_store.get_run(service.database, run_id)
    shown, outcomes = run_view(service, record), outcomes_of(service, [record])
    events = event_store.events_of(service.database, run_id)
    visits = visit_store.list_visits(
        service.database, states=OPEN_VISIT, run_id=run_id, external=True, limit=_VISITS + 1
    )
    trainings = training_views(service.database, run_id, events)
    finished = [e.event for e in events if isinstance(e.event, CriticismFinished)]
    criticism = criticism_view(shown, finished[-1]) if finished else None
    has_policy = any(outcome.iteration.policies for outcome in outcomes)
    return show(
        request,
        "run.html",
        live=not record.is_finished,
        title=title_of(record.spec),
        run=shown,
        remedy=None if record.error_code is None else remedy_of(record.error_code),
        now=service.orchestrator.clock.now(),
        waiting=[task_view(visit) for visit in visits[:_VISITS]],
        more_wait=len(visits) > _VISITS,
        verdict=criticism.verdict if criticism else None,
        told=told(criticism.verdict) if criticism and criticism.verdict else [],
        interval_text=interval_text,
        quantity_text=quantity_text,
        methods=[name for name, each in methods().items() if not each.is_reference],
        presets=list(PRESETS),
        untrained=untrained(criticism.verdict) if criticism and criticism.verdict else [],
        files={n: a for n, a in criticism.links.items() if "." in n} if criticism else {},
        rows=table(outcomes),
        iterations=len(outcomes),
        has_policy=has_policy,
        hidden_links={"cost"} if has_policy else {"cost", "policy", "distribution"},
        figures=drawable(outcomes),
        captions=CAPTIONS,
        estimates=estimates(outcomes),
        lost=lost(outcomes),
        inferences=[each.iteration for each in outcomes if each.iteration.diagnostics],
        trainings=trainings,
        has_curves=isinstance(record.spec, RunSpec),
        timeline=timeline(
            stage_store.executions_of(service.database, [run_id]), record.created_at.timestamp()
        ),
        events=[e for e in events if not isinstance(e.event, TrainingEvaluated)],
        words_of=words_of,
        chosen_of=chosen_of,
        ray=service.dashboard_url,
    )


def chosen_of(diagnostics: Mapping[str, Any]) -> str:
    """The value that the method took of a setting, and whether it is the last that was tried; empty
    where the method chose among none."""
    for name, tried in diagnostics.items():
        _, by, setting = name.partition("_by_")
        if not by or not isinstance(tried, dict):
            continue
        values = cast(dict[str, Any], tried)
        criteria = [c if isinstance(c, int | float) else None for c in values.values()]
        if sum(c is not None for c in criteria) > 1:
            best = list(values)[Grid(setting, name).best(criteria)]
            end = ", the last of those tried" if best == list(values)[-1] else ""
            return f"{setting} {best}{end}"
    return ""


def untrained(verdict: Mapping[str, Any]) -> list[str]:
    """The kinds of a verdict's causes that act on commands or in sensors."""
    mechanisms = {cause["kind"]: MECHANISMS.get(cause["kind"]) for cause in verdict["causes"]}
    # an old verdict may have kinds that are not known any more
    return [kind for kind, each in mechanisms.items() if each and (each.command or each.sensing)]


def words_of(event: RunEvent) -> str:
    """An event's values in a few words."""
    match event:
        case StageFinished():
            return f"{event.kind} {event.digest[:8]}"
        case IterationFinished():
            returns = [value for policy in event.returns for value in policy]
            parts = [f"iteration {event.iteration}", f"{event.target_transitions} transitions seen"]
            if returns:
                parts.append(f"target return {sum(returns) / len(returns):.0f}")
            return ", ".join(parts)
        case CriticismFinished():
            return str(event.verdict["verdict"])
        case RunFailed():
            return event.message
        case _:
            return ""


def timeline(executions: Sequence[tuple[str, Execution]], since: float) -> Timeline:
    """The latest stages that were asked for `since` [s since the epoch], as bars.

    Other runs may have asked for the others long before.
    """
    ordered = sorted(executions, key=lambda each: each[1].asked)
    shown = [each for each in ordered if each[1].asked >= since][-_MOST_BARS:]
    if not shown:
        return Timeline([], "", len(ordered))
    first = min(execution.asked for _, execution in shown)
    span = max(max(execution.ended for _, execution in shown) - first, 1e-9)

    def part(name: str, start: float, end: float) -> Part:
        return Part(name, (start - first) / span, max(end - start, 0.0) / span)

    bars = [
        Bar(
            kind,
            [
                part("waits", e.asked, e.placed),
                part("starts", e.placed, e.began + (e.preparing or 0.0)),
                part("computes", e.began + (e.preparing or 0.0), e.ended),
            ],
            e.seconds,
        )
        for kind, e in shown
    ]
    return Timeline(bars, in_words(span / 3600), len(ordered) - len(shown))


class Training(BaseModel):
    """The fields of the form that trains on an extended simulator."""

    method: str
    preset: str
    seed: int


@router.post("/runs/{run_id}/train")
def train(run_id: str, service: ServiceDependency, given: Annotated[Training, Form()]) -> Response:
    """Submit a run whose source is extended by the effects that a criticism has named."""
    spec = run_store.get_run(service.database, run_id).spec
    effects = json.loads(bytes(criticisms.file(run_id, "effects.json", service).body))
    named: dict[str, Any] = {"extension": effects_of(effects, "effects.json")}
    try:
        extended = RunSpec.model_validate(
            {"task": spec.task, "variant": spec.variant, **named, **given.model_dump()}
        )
    except ValidationError as error:
        raise InvalidInput(explain(error, "the form")) from error
    return RedirectResponse(f"/runs/{start_run(service, extended, None).id}", SEE_OTHER)


@router.post("/runs/{run_id}/cancel")
def cancel(run_id: str, service: ServiceDependency) -> Response:
    routes.cancel(run_id, service)
    return RedirectResponse(f"/runs/{run_id}", SEE_OTHER)


@router.post("/runs/{run_id}/resume")
def resume(run_id: str, service: ServiceDependency) -> Response:
    routes.resume(run_id, service)
    return RedirectResponse(f"/runs/{run_id}", SEE_OTHER)

"""The page that submits a benchmark, with its price before it starts."""

import json
from collections.abc import Sequence
from typing import Annotated, Any, Literal, get_args

from fastapi import APIRouter, Form, Request, Response
from fastapi.responses import RedirectResponse
from pydantic import BaseModel, Field, ValidationError

from adr_service.benchmark.plan import Plan
from adr_service.errors import InvalidInput
from adr_service.json_values import message_of
from adr_service.methods.catalogue import methods
from adr_service.presets import PRESETS
from adr_service.specs import BenchmarkSpec
from adr_service.specs.names import Collector
from adr_service.tasks.catalogue import catalogue, variants
from api.durations import in_words
from api.page.names import numbers_in
from api.page.rendering import SEE_OTHER, UNPROCESSABLE, show
from api.routes.submissions import plan_here, start_benchmark
from api.service import ServiceDependency
from api.specs import assign
from db import benchmarks as benchmark_store

router = APIRouter(include_in_schema=False)
_HAVE_OWN_FIELDS = {"references", "preset", "seeds", "tasks", "variants", "methods", "collectors"}


class Given(BaseModel):
    """The fields of the form, as they were filled in."""

    tasks: list[str] = []
    variants: list[str] = []
    methods: list[str] = []
    collectors: list[str] = []
    seeds: Annotated[str, Field(max_length=100_000)] = ""
    preset: str = "quick"
    references: bool = False
    settings: Annotated[str, Field(max_length=5_000)] = ""  # each line is compared with all
    act: Literal["plan", "start"] = "plan"


_FIRST = Given(
    tasks=["arm"],
    variants=["vanilla"],
    methods=["simopt", "dropo"],
    collectors=["simopt"],
    seeds="0 1 2",
    preset="demo",
    references=True,
)


@router.get("/submit")
def form(request: Request, service: ServiceDependency, like: str | None = None) -> Response:
    """The form, filled in as a benchmark was."""
    if like is None:
        return _form(request, _FIRST)
    spec = benchmark_store.readable(benchmark_store.get_benchmark(service.database, like))
    own = [f"the settings of {each.name}" for each in spec.methods if not isinstance(each, str)]
    names = [each if isinstance(each, str) else each.name for each in spec.methods]
    references = [name for name in names if methods()[name].is_reference]
    return _form(request, as_filled_in(spec), without=[*own, *references])


@router.post("/submit")
def submit(
    request: Request, service: ServiceDependency, given: Annotated[Given, Form()]
) -> Response:
    try:
        spec = spec_of(given)
        if given.act == "plan":
            return _form(request, given, plan=plan_here(service, list(spec.runs())))
        record = start_benchmark(service, spec, None)
    except ValidationError as error:
        return _form(request, given, errors=_explained(error))
    except InvalidInput as error:
        return _form(request, given, errors=[str(error)])
    return RedirectResponse(f"/benchmarks/{record.id}", SEE_OTHER)


def _form(
    request: Request,
    given: Given,
    *,
    plan: Plan | None = None,
    errors: Sequence[str] = (),
    without: Sequence[str] = (),
) -> Response:
    """The form; `without` are parts of a spec that it cannot have."""
    return show(
        request,
        "submit.html",
        status_code=UNPROCESSABLE if errors else 200,
        given=given,
        tasks=list(catalogue()),
        variants=variants(),
        methods=[name for name, each in methods().items() if not each.is_reference],
        collectors=get_args(Collector),
        presets=list(PRESETS),
        plan=plan,
        errors=errors,
        without=without,
        duration=in_words,
    )


def spec_of(given: Given) -> BenchmarkSpec:
    """Raises ValidationError, and InvalidInput for seeds or settings that cannot be read."""
    lists = given.model_dump(include={"tasks", "variants", "methods", "collectors"})
    spec: dict[str, Any] = {**lists, "seeds": numbers_in(given.seeds), "preset": given.preset}
    spec["references"] = given.references
    settings = [line.strip() for line in given.settings.splitlines() if line.strip()]
    assign(spec, settings, fixed=list(spec))
    return BenchmarkSpec.model_validate(spec)


def _explained(error: ValidationError) -> list[str]:
    """A sentence for each wrong field."""
    return [
        f"{'.'.join(map(str, each['loc'])) or 'benchmark'}: {message_of(each)}"
        for each in error.errors()
    ]


def as_filled_in(spec: BenchmarkSpec) -> Given:
    """A benchmark as the form would have it; methods lose settings of their own."""
    others = spec.model_dump(mode="json", exclude_unset=True, exclude=_HAVE_OWN_FIELDS)
    return Given(
        tasks=list(spec.tasks),
        variants=list(spec.variants),
        methods=[each if isinstance(each, str) else each.name for each in spec.methods],
        collectors=list(spec.collectors),
        seeds=" ".join(map(str, spec.seeds)),
        preset=spec.preset,
        references=spec.references,
        settings="\n".join(_assignments(others)),
    )


def _assignments(fields: dict[str, Any], path: str = "") -> list[str]:
    """Fields as lines that `assign` reads."""
    lines: list[str] = []
    for name, value in fields.items():
        if isinstance(value, dict):
            lines += _assignments(value, f"{path}{name}.")
        else:
            lines.append(f"{path}{name}={json.dumps(value)}")
    return lines

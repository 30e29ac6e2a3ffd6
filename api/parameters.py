"""Parameters of requests, as the API's page describes them, and which are refused."""

from typing import Annotated, Literal, TypeAlias, get_origin

from fastapi import Depends, Path, Query, Request, params
from fastapi.dependencies.utils import get_flat_params
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute

from adr_service.benchmark.figures import Format

RunId: TypeAlias = Annotated[str, Path(description="of a run, as `run_…`")]
BenchmarkId: TypeAlias = Annotated[str, Path(description="of a benchmark, as `bench_…`")]
TargetTaskId: TypeAlias = Annotated[str, Path(description="of a target task, as `task_…`")]
DatasetId: TypeAlias = Annotated[str, Path(description="of a recording, as `data_…`")]
Digest: TypeAlias = Annotated[str, Path(description="of what is stored, as results name it")]
FigureName: TypeAlias = Annotated[str, Path(description="one of the list of figures")]
FileName: TypeAlias = Annotated[str, Path(description="one of the criticism's files")]
FileFormat: TypeAlias = Annotated[Format, Path(description="of an image, or its numbers")]
TableFormat: TypeAlias = Annotated[Literal["json", "csv"], Query(description="of the answer")]
ValidateOnly: TypeAlias = Annotated[bool, Query(description="tell the cost, and store nothing")]


def _renewed(renewed: Annotated[int, Query(description="any number; another one asks anew")] = 0):
    """Ignored: with a new number, a browser loads a figure again."""


RENEWED = Depends(_renewed)


async def check_parameters(request: Request) -> None:
    """Refuse a parameter that the route does not have (a mistyped `validate_only` would start a
    run), and a second value of one that is no list, which would count alone."""
    route = request.scope["route"]
    assert isinstance(route, APIRoute)
    fields = get_flat_params(route.dependant)
    # a model's fields are pydantic's, and no `Query`
    elsewhere = (params.Path, params.Header, params.Cookie)
    known = {field.alias for field in fields if not isinstance(field.field_info, elsewhere)}
    lists = {field.alias for field in fields if get_origin(field.field_info.annotation) is list}
    accepted = f"accepted: {', '.join(sorted(known))}" if known else "there are none here"
    wrong: list[dict[str, object]] = []
    for name in request.query_params:
        values = request.query_params.getlist(name)
        if name not in known:
            message = f"there is no parameter {name!r}; {accepted}"
        elif len(values) > 1 and name not in lists:
            message = f"{name} has one value; given {len(values)}"
        else:
            continue
        given = values[0] if len(values) == 1 else values
        wrong.append({"type": "parameter", "loc": ("query", name), "msg": message, "input": given})
    if wrong:
        raise RequestValidationError(wrong)

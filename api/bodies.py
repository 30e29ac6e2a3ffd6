"""Specs in bodies, validated on threads.

FastAPI validates bodies on the event loop, and all other requests wait meanwhile; a benchmark takes
as long as all its runs. Here FastAPI passes bodies unread to functions on threads. Their
description in the API's reference stays the same.
"""

from typing import Annotated, Any, TypeVar

from fastapi import Body, Depends
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError, WrapValidator
from pydantic_core import ErrorDetails

from adr_service.specs import BenchmarkExtension, BenchmarkSpec, CriticismSpec, RunSpec

S = TypeVar("S", bound=BaseModel)
_UNREAD = WrapValidator(lambda given, _: given)
_RUN = {"task": "arm", "method": "dropo", "seed": 0, "preset": "smoke"}
_BENCHMARK = {"tasks": ["arm"], "methods": ["simopt", "dropo"], "seeds": [0], "preset": "smoke"}
_CRITICISM = {"task": "arm", "dataset": "data_0123456789abcdef"}


def _run(given: Annotated[RunSpec, _UNREAD, Body(examples=[_RUN])]) -> RunSpec:
    return _validated(RunSpec, given)


def _benchmark(
    given: Annotated[BenchmarkSpec, _UNREAD, Body(examples=[_BENCHMARK])],
) -> BenchmarkSpec:
    return _validated(BenchmarkSpec, given)


def _extension(
    given: Annotated[BenchmarkExtension, _UNREAD, Body(examples=[{"seeds": [1]}])],
) -> BenchmarkExtension:
    return _validated(BenchmarkExtension, given)


def _criticism(
    given: Annotated[CriticismSpec, _UNREAD, Body(examples=[_CRITICISM])],
) -> CriticismSpec:
    return _validated(CriticismSpec, given)


RunBody = Annotated[RunSpec, Depends(_run)]
BenchmarkBody = Annotated[BenchmarkSpec, Depends(_benchmark)]
ExtensionBody = Annotated[BenchmarkExtension, Depends(_extension)]
CriticismBody = Annotated[CriticismSpec, Depends(_criticism)]


def _validated(kind: type[S], given: Any) -> S:
    try:
        return kind.model_validate(given)
    except ValidationError as error:
        errors = [{**each, "loc": ("body", *_place(each, given))} for each in error.errors()]
        raise RequestValidationError(errors) from error


def _place(error: ErrorDetails, given: Any) -> list[int | str]:
    """Names and numbers that lead to an error in a body.

    Pydantic's have the tags of unions between them, such as a method's name.
    """
    place: list[int | str] = []
    for part in error["loc"]:
        try:
            given = given[part]
        except (LookupError, TypeError):
            continue  # a tag
        place.append(part)
    is_absent = error["type"] == "missing"
    return [*place, error["loc"][-1]] if is_absent else place

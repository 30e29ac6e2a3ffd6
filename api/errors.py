"""Errors as problem documents (RFC 9457): what was given, and what is accepted."""

import logging
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match, Route

from adr_service.errors import AdrError
from adr_service.json_values import message_of

log = logging.getLogger(__name__)
_STATUS = {
    "not_found": 404,
    "unknown_name": 404,
    "conflict": 409,
    "lost_spec": 409,
    "lease_lost": 409,
    "invalid_input": 422,
    "cluster_unavailable": 503,
    "queue_full": 429,
    "database_unavailable": 503,
    "database_in_use": 503,
    "database_gone": 503,
    "disk_full": 507,
    "no_film": 503,
}
DEFECT = "the service has a defect; its log says more"
_RETRY_AFTER_S = 5
_LONGEST = 200  # characters of a given value that a problem repeats
_MOST_ERRORS = 50  # of fields, in one problem


class Problem(BaseModel):
    """A refusal and its reason (RFC 9457)."""

    type: str
    title: str
    status: int
    detail: str
    errors: list[dict[str, str]] = []  # of fields: pointer, detail, given


def install(app: FastAPI) -> None:
    """Make an application answer every error as a problem document."""
    app.add_exception_handler(AdrError, _adr_error)
    app.add_exception_handler(RequestValidationError, _validation_error)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(ClientDisconnect, _disconnected)
    app.add_exception_handler(Exception, _defect)


def problem(status: int, code: str, detail: str, **more: Any) -> JSONResponse:
    """Return a problem document; `more` are members beside the standard ones."""
    body = {
        "type": f"/problems/{code}",
        "title": code.replace("_", " "),
        "status": status,
        "detail": _whole(detail),
        **more,
    }
    return JSONResponse(body, status, media_type="application/problem+json")


async def _adr_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, AdrError)
    response = problem(_STATUS.get(error.code, 500), error.code, str(error))
    if response.status_code in (429, 503, 507):
        response.headers["Retry-After"] = str(_RETRY_AFTER_S)
    return response


async def _validation_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    errors = [_field_error(each, error, request) for each in error.errors()[:_MOST_ERRORS]]
    more = len(error.errors()) - len(errors)
    detail = "the request is not valid" + (f"; {more} more errors are left out" if more else "")
    return problem(422, "invalid_input", detail, errors=errors)


def _field_error(each: Any, error: RequestValidationError, request: Request) -> dict[str, str]:
    """Return the pointer to a field, the reason of its refusal, and the given value."""
    if each["type"] == "json_invalid":
        reason, position = each["ctx"]["error"], each["loc"][-1]
        detail = f"the body must be JSON: {reason}, at character {position}"
        return {"pointer": "/body", "detail": detail, "given": _shorten(repr(error.body))}
    if each["loc"] == ("body",) and isinstance(each["input"], bytes):
        given = request.headers.get("Content-Type")
        return {
            "pointer": "/body",
            "detail": "the body must be JSON, with the header 'Content-Type: application/json'",
            "given": "no Content-Type" if given is None else _shorten(f"Content-Type: {given}"),
        }
    return {
        "pointer": _shorten("/" + "/".join(str(part) for part in each["loc"])),
        "detail": _whole(message_of(each)),
        "given": "nothing" if each["type"] == "missing" else _shorten(repr(each["input"])),
    }


async def _http_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    title = HTTPStatus(error.status_code).phrase.lower()
    response = problem(error.status_code, "http_error", str(error.detail), title=title)
    response.headers.update(error.headers or {})
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED and (allowed := _methods_of(request)):
        response.headers["Allow"] = ", ".join(sorted(allowed))
    return response


def _methods_of(request: Request) -> set[str]:
    """Return the methods that a path accepts; Starlette looks at one route at a time."""
    routers: Sequence[APIRouter] = request.app.state.routers
    routes = [route for router in routers for route in router.routes if isinstance(route, Route)]
    matching = [route for route in routes if route.matches(request.scope)[0] is not Match.NONE]
    mine = [route for route in matching if route.path == matching[0].path]
    return {method for route in mine for method in route.methods or ()} - {"HEAD"}


async def _disconnected(request: Request, error: Exception) -> JSONResponse:
    """Nobody reads this answer, but without it the log would show a defect."""
    return problem(400, "disconnected", "the client went away before all of its body came")


async def _defect(request: Request, error: Exception) -> JSONResponse:
    log.exception("%s %s", request.method, request.url.path, exc_info=error)
    return problem(500, "internal", DEFECT)


def _whole(text: str) -> str:
    """Return text without half characters (lone surrogates), which UTF-8 cannot encode."""
    return text.encode(errors="backslashreplace").decode()


def _shorten(text: str) -> str:
    text = _whole(text)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"

"""Parameters in the query of a request: those that a route does not have are refused."""

from typing import Annotated

import pytest
from fastapi import Depends, FastAPI, Query
from fastapi.testclient import TestClient

from adr_service.specs import BenchmarkPart
from api import errors
from api.parameters import check_parameters
from api.routes.paging import PageSize


@pytest.fixture(scope="module")
def counting():
    """A client of an application that counts what it started."""
    app, started = FastAPI(), []
    errors.install(app)

    def by_default(limit: PageSize = 10) -> int:
        return limit

    @app.post("/runs", dependencies=[Depends(check_parameters)])
    def start(validate_only: bool = False, limit: int = Depends(by_default)) -> int:
        started.append(validate_only)
        return len(started)

    @app.get("/archive", dependencies=[Depends(check_parameters)])
    def archive(part: Annotated[BenchmarkPart, Query()]) -> list[str]:
        return part.seeds

    @app.get("/health", dependencies=[Depends(check_parameters)])
    def health() -> None: ...

    with TestClient(app) as client:
        yield client, started


def test_a_mistyped_parameter_starts_nothing(counting):
    client, started = counting
    answer = client.post("/runs?validateonly=true&x=1")
    assert answer.status_code == 422
    first, second = answer.json()["errors"]
    assert first == {
        "pointer": "/query/validateonly",
        "detail": "there is no parameter 'validateonly'; accepted: limit, validate_only",
        "given": "'true'",
    }
    assert second["pointer"] == "/query/x"
    assert started == []


def test_parameters_of_a_route_and_of_its_dependencies_are_accepted(counting):
    client, started = counting
    assert client.post("/runs?validate_only=true&limit=5").status_code == 200
    assert started == [True]


def test_a_list_takes_each_of_its_values(counting):
    """A part of a benchmark with two seeds was refused, and with it the report of every study."""
    client, _ = counting
    assert client.get("/archive?seeds=0&seeds=1").json() == ["0", "1"]


def test_a_second_value_is_refused(counting):
    """The last one counted, and the others were ignored."""
    client, started = counting
    before = len(started)
    (error,) = client.post("/runs?limit=5&limit=6").json()["errors"]
    assert (error["pointer"], error["detail"]) == ("/query/limit", "limit has one value; given 2")
    assert error["given"] == "['5', '6']"
    assert len(started) == before


def test_a_route_without_parameters_says_so(counting):
    client, _ = counting
    (error,) = client.get("/health?deep=1").json()["errors"]
    assert error["detail"] == "there is no parameter 'deep'; there are none here"


@pytest.mark.ray
def test_the_service_checks_parameters_but_not_those_of_its_page(http):
    for path in ("/v1/runs", "/v1/benchmarks", "/v1/claims", "/v1/tasks"):
        assert http.get(f"{path}?utm=mail").status_code == 422
    assert http.get("/?utm=mail").status_code == 200

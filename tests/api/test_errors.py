"""Errors as problem documents: what was given, and what is accepted."""

import json

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from api import errors
from api.bodies import RunBody
from tests.api.smoke import SMOKE

ray = pytest.mark.ray


@pytest.fixture(scope="module")
def runs():
    """A client of an application that takes runs and does nothing with them."""
    app = FastAPI()
    errors.install(app)

    @app.post("/runs")
    def route(spec: RunBody) -> None: ...

    @app.post("/broken")
    def broken(spec: RunBody) -> None:
        raise ZeroDivisionError("a secret in the message")

    @app.post("/numbers")
    def numbers(values: list[int]) -> None: ...

    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.mark.parametrize(
    ("headers", "given"),
    [
        ({}, "no Content-Type"),
        ({"Content-Type": "text/plain"}, "Content-Type: text/plain"),
        ({"Content-Type": "application/" + "x" * 500}, "Content-Type: application/xxx"),
    ],
    ids=["none", "text", "long"],
)
def test_a_body_that_is_not_declared_as_json_is_refused_with_its_type(runs, headers, given):
    answer = runs.post("/runs", content=json.dumps(SMOKE), headers=headers)
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["pointer"] == "/body"
    assert "the header 'Content-Type: application/json'" in error["detail"]
    assert error["given"].startswith(given)
    assert len(error["given"]) <= 200


@pytest.mark.parametrize(
    ("content", "position", "given"),
    [
        (b'{"task": ', 9, "'{\"task\": '"),
        (b"task=arm", 0, "'task=arm'"),
        (b"x" * 1000, 0, "'xxx"),
    ],
)
def test_a_body_that_is_not_json_is_refused_with_the_place_of_the_error(
    runs, content, position, given
):
    answer = runs.post("/runs", content=content, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["pointer"] == "/body"
    assert error["detail"] == f"the body must be JSON: Expecting value, at character {position}"
    assert error["given"].startswith(given)
    assert len(error["given"]) <= 200


def test_a_missing_body_is_named(runs):
    (error,) = runs.post("/runs").json()["errors"]
    assert error == {"pointer": "/body", "detail": "Field required", "given": "nothing"}


@pytest.mark.parametrize(
    ("changed", "pointer"),
    [
        ({"sed": 1}, "/body/sed"),
        ({"method": {"name": "dropo", "samplez": 1}}, "/body/method/samplez"),
        ({"training": {"steps": 1}}, "/body/training/steps"),
        ({"method": {"name": "simopt", "samples": "x"}}, "/body/method/samples"),
        ({"extension": [{"kind": "wind", "values": [1]}]}, "/body/extension/0/location"),
    ],
)
def test_the_pointer_of_a_refused_field_is_its_place_in_the_body(runs, changed, pointer):
    (error,) = runs.post("/runs", json={**SMOKE, **changed}).json()["errors"]
    assert error["pointer"] == pointer


def test_a_defect_is_a_problem_without_its_message(runs):
    answer = runs.post("/broken", json=SMOKE)
    assert answer.status_code == 500
    assert answer.json()["detail"] == "the service has a defect; its log says more"


@pytest.mark.parametrize("number", [1, 50, 51])
def test_a_problem_repeats_fifty_errors_at_most(runs, number):
    problem = runs.post("/numbers", json=["x"] * number).json()
    assert len(problem["errors"]) == min(number, 50)
    assert ("1 more errors are left out" in problem["detail"]) == (number == 51)


def refused(service, http, body, given, accepted, path="/v1/runs"):
    before = len(service.client.list_all("runs"))
    headers = {"Content-Type": "application/json"}
    response = http.post(path, content=body, headers=headers)
    assert response.status_code == 422
    assert response.headers["Content-Type"] == "application/problem+json"
    (first, *_) = response.json()["errors"]
    assert given in first["given"] + first["detail"]
    assert accepted in first["detail"]
    assert len(service.client.list_all("runs")) == before


@ray
@pytest.mark.parametrize(
    ("body", "given", "accepted"),
    [
        ({**SMOKE, "method": "magic"}, "magic", "auto_dr, doraemon, epopt"),
        ({**SMOKE, "task": "hoper"}, "hoper", "arm, hopper"),
        ({**SMOKE, "variant": "windy"}, "windy", "vanilla, noisy, unmodeled"),
        ({**SMOKE, "iterations": -1}, "-1", "greater than or equal to 1"),
        ({**SMOKE, "seed": "0"}, "'0'", "valid integer"),
        ({**SMOKE, "sed": 0}, "sed", "did you mean 'seed'"),
        ({**SMOKE, "method": {"name": "dropo", "budget": -5}}, "-5", "greater than"),
        ([], "[]", "dictionary"),
        ({}, "nothing", "Field required"),
    ],
    ids=str,
)
def test_an_invalid_spec_is_refused_with_the_accepted_values(service, http, body, given, accepted):
    refused(service, http, json.dumps(body), given, accepted)


@ray
@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
def test_numbers_that_are_not_finite_are_refused(service, http, number):
    body = json.dumps(SMOKE)[:-1] + f', "training": {{"gamma": {number}}}}}'
    refused(service, http, body, "nan" if number == "NaN" else "inf", "finite")


@ray
def test_broken_json_is_refused(service, http):
    refused(service, http, '{"task": ', "", "JSON")


@ray
def test_a_bad_benchmark_stores_no_run(service, http):
    body = json.dumps({"tasks": ["arm", "leg"], "methods": ["udr"], "preset": "smoke"})
    refused(service, http, body, "leg", "arm, hopper", path="/v1/benchmarks")


@ray
@pytest.mark.parametrize(
    "path",
    [
        "/v1/runs/run_x",
        "/v1/runs/run_x/events",
        "/v1/runs/run_x/policy",
        "/v1/benchmarks/bench_x",
        "/v1/benchmarks/bench_x/results",
        "/v1/artifacts/abc",
        "/benchmarks/bench_x",
        "/nowhere",
    ],
)
def test_an_unknown_path_or_id_is_a_404_problem(http, path):
    response = http.get(path)
    assert response.status_code == 404
    assert response.headers["Content-Type"] == "application/problem+json"


@ray
def test_a_body_of_megabytes_is_refused(http):
    response = http.post("/v1/runs", content=b"[" + b"1," * 1_000_000 + b"1]")
    assert response.status_code == 413


@pytest.mark.parametrize("target", [{"episodes": 1}, {"kind": "robot"}], ids=str)
def test_a_target_without_a_known_kind_is_refused_with_all_kinds(runs, target):
    (error,) = runs.post("/runs", json={**SMOKE, "target": target}).json()["errors"]
    assert error["pointer"].startswith("/body")
    assert error["pointer"].endswith("/target")
    assert error["detail"] == "the 'kind' of a target is one of simulated, recorded, external"

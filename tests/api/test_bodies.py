"""Bodies of requests: everything in them has a limit, and none of them holds others up."""

import itertools
import json
import threading

import httpx2
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from api import errors
from api.app import create_app
from api.bodies import BenchmarkBody, CriticismBody, ExtensionBody, RunBody
from api.settings import Settings

DESCRIPTION = create_app(Settings()).openapi()
LARGEST = 990_000  # bytes, nearly as many as a body may have
BASES = {
    "/v1/runs": {"task": "arm", "method": "dropo", "preset": "smoke"},
    "/v1/benchmarks": {"tasks": ["arm"], "methods": ["prior"], "preset": "smoke"},
    "/v1/benchmarks/{benchmark_id}/extend": {},
    "/v1/target_tasks/claim": {"worker": "w", "tasks": ["arm"]},
}
NEEDED = {  # by type, any of the keywords that bound a value
    "string": {"maxLength", "enum", "const", "pattern"},
    "integer": {"maximum", "exclusiveMaximum", "enum", "const"},
    "array": {"maxItems"},
}


def resolved(schema):
    while "$ref" in schema:
        schema = DESCRIPTION["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    return schema


def leaves(schema, place=()):
    """(place, schema) of a schema and everything below it."""
    schema = resolved(schema)
    for inner in itertools.chain(*(schema.get(kind, []) for kind in ("anyOf", "oneOf"))):
        yield from leaves(inner, place)
    yield place, schema
    if "items" in schema:
        yield from leaves(schema["items"], (*place, 0))
    for name, inner in schema.get("properties", {}).items():
        yield from leaves(inner, (*place, name))


def json_bodies():
    for path, methods in DESCRIPTION["paths"].items():
        for route in methods.values():
            content = route.get("requestBody", {}).get("content", {})
            if "application/json" in content:
                yield path, content["application/json"]["schema"]


LISTS = sorted(
    {
        (path, place)
        for path, schema in json_bodies()
        for place, inner in leaves(schema)
        if inner.get("type") == "array" and 0 not in place
    }
)


def test_every_text_list_and_whole_number_of_a_body_has_a_limit():
    assert len(list(json_bodies())) >= 7
    for path, schema in json_bodies():
        for place, inner in leaves(schema):
            needed = NEEDED.get(inner.get("type"), set(inner))
            assert needed & inner.keys(), f"{path} {place}"


def test_a_spec_is_refused_as_by_fastapi_itself():
    app = FastAPI()
    errors.install(app)

    @app.post("/")
    def route(spec: BenchmarkBody) -> int:
        return spec.size

    with TestClient(app) as client:
        assert client.post("/", json={"tasks": ["arm"], "methods": ["prior"]}).json() == 6
        refused = client.post("/", json={"tasks": ["arm"], "methods": ["priro"]}).json()
    assert refused["errors"][0]["pointer"] == "/body/methods/0"
    assert "did you mean 'prior'" in refused["errors"][0]["detail"]


def test_half_characters_and_endless_numbers_are_refused():
    app = FastAPI()
    errors.install(app)

    @app.post("/run")
    def run(spec: RunBody) -> None: ...

    @app.post("/criticism")
    def criticism(spec: CriticismBody) -> None: ...

    @app.post("/extension")
    def extension(spec: ExtensionBody) -> None: ...

    run_of = {"task": "arm", "method": "droid", "preset": "smoke"}
    half = "\ud800"
    bodies = [
        ("/run", {**run_of, "target": {"kind": "recorded", "dataset": half}}),
        ("/run", {**run_of, half: half}),
        ("/run", {**run_of, "method": half}),
        ("/run", {**run_of, "training": {"max_steps": 10**400}}),
        ("/criticism", {"task": "arm", "dataset": half}),
        ("/extension", {"tasks": [half], "seeds": [10**400]}),
    ]
    with TestClient(app) as client:
        for path, body in bodies:
            headers = {"Content-Type": "application/json"}
            refused = client.post(path, content=json.dumps(body), headers=headers)
            assert refused.status_code == 422, body
            assert refused.json()["errors"]


@pytest.mark.ray
@pytest.mark.parametrize(("path", "place"), LISTS)
@pytest.mark.parametrize("member", ["numbers", "texts"])
def test_a_list_as_long_as_a_body_is_refused_while_others_are_answered(
    service, path, place, member
):
    """40,000 seeds stopped the whole service for half a minute."""
    body = json.loads(json.dumps(BASES[path]))
    inner = body
    for name in place[:-1]:
        if not isinstance(inner.get(name), dict):
            inner[name] = {"kind": "simulated"} if name == "target" else {"name": "dropo"}
        inner = inner[name]
    make = (lambda i: i) if member == "numbers" else (lambda i: f"x{i}")
    inner[place[-1]] = [make(i) for i in range(LARGEST // 10)]
    answers = []
    with httpx2.Client(base_url=service.client.url, timeout=15) as http:
        url = path.replace("{benchmark_id}", "bench_0")
        sent = threading.Thread(target=lambda: answers.append(http.post(url, json=body)))
        sent.start()
        with httpx2.Client(base_url=service.client.url, timeout=5) as other:
            while not answers and sent.is_alive():
                assert other.get("/healthz").status_code == 200
        sent.join()
    (answer,) = answers
    assert answer.status_code == 422, answer.text[:500]
    assert len(answer.content) < 100_000

"""Limits on hosts, origins, tokens, rates and bodies, without a service."""

import time

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from api import errors
from api.guard import Guard
from api.settings import Settings
from tests.service import until

TOKEN, ROBOT = "u" * 32, "r" * 32


def guarded(**settings):
    """A client of an application behind the guard, as its own host."""
    app = FastAPI()
    errors.install(app)

    @app.post("/v1/runs")
    def submit(body: dict) -> None: ...

    @app.post("/v1/files", max_body_size=2_000_000)
    def upload(body: dict) -> None: ...

    @app.get("/v1/tasks")
    def tasks() -> None: ...

    app.add_middleware(Guard, settings=Settings(**settings))
    return TestClient(app, base_url="http://127.0.0.1")


def test_without_a_token_everything_on_this_machine_is_open():
    assert guarded().get("/v1/tasks").status_code == 200


@pytest.mark.parametrize(
    ("token", "statuses"), [(TOKEN, (200, 200)), (ROBOT, (200, 403)), ("x" * 32, (401, 401))]
)
def test_a_token_opens_its_paths_alone(token, statuses):
    client = guarded(token=TOKEN, robot_token=ROBOT)
    headers = {"Authorization": f"Bearer {token}"}
    answers = (
        client.get("/v1/tasks", headers=headers),
        client.post("/v1/runs", json={}, headers=headers),
    )
    assert tuple(answer.status_code for answer in answers) == statuses


@pytest.mark.parametrize(
    ("host", "allowed", "status"),
    [
        ("127.0.0.1:8000", "", 200),
        ("[::1]:8000", "", 200),
        ("adr.example.org", "", 400),
        ("adr.example.org:443", "adr.example.org, other.example.org", 200),
        ("lab-pc", "Lab-PC", 200),  # browsers send small letters
    ],
)
def test_only_names_of_the_service_are_answered(host, allowed, status):
    answer = guarded(allowed_hosts=allowed).get("/v1/tasks", headers={"Host": host})
    assert answer.status_code == status


@pytest.mark.parametrize(("size", "status"), [(900_000, 200), (1_100_000, 413)])
def test_a_large_body_is_refused_with_the_limit(size, status):
    answer = guarded().post("/v1/runs", json={"x": "y" * size})
    assert answer.status_code == status
    assert ("the body may have 1000000 bytes here" in answer.text) == (status == 413)


def test_a_large_body_of_unknown_length_is_refused_alike():
    for path, most in (("/v1/runs", 1_000_000), ("/v1/files", 2_000_000)):
        size = most + 100_000
        known, unknown = (
            guarded().post(path, content=content, headers={"Content-Type": "application/json"})
            for content in (b"x" * size, (b"x" * 100_000 for _ in range(size // 100_000)))
        )
        assert "Content-Length" not in unknown.request.headers
        assert (unknown.status_code, unknown.json()) == (413, known.json())
        assert known.json()["detail"] == f"the body may have {most} bytes here"


@pytest.mark.parametrize(
    ("charset", "status"),
    [("", 422), ("; charset=UTF-8", 422), ("; charset=punycode", 415), ("; charset=utf-7", 415)],
)
def test_forms_are_in_utf_8(charset, status):
    """Half a megabyte of punycode stopped the service for ten seconds, without a token."""
    body = b'--x\r\nContent-Disposition: form-data; name="token"\r\n\r\na-b\r\n--x--\r\n'
    kind = f"multipart/form-data; boundary=x{charset}"
    answer = guarded().post("/v1/runs", content=body, headers={"Content-Type": kind})
    assert answer.status_code == status


def test_every_answer_protects_browsers():
    client = guarded(token=TOKEN)
    for answer in (client.get("/v1/tasks"), client.get("/nowhere"), client.get("/healthz")):
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Content-Security-Policy"].startswith("default-src 'none'")


def test_every_one_of_several_rates_is_kept():
    client = guarded(rate="100/second; 3/hour")
    answers = [client.get("/v1/tasks") for _ in range(7)]  # the hour may end once
    refused = [answer for answer in answers if answer.status_code == 429]
    assert refused
    assert all(answer.json()["detail"].endswith("3 per 1 hour") for answer in refused)


def test_a_wall_clock_that_is_set_back_keeps_nobody_out(monkeypatch):
    guard = Guard(FastAPI(), Settings(rate="2/second"))
    assert until(lambda: guard._too_many("192.0.2.1"))
    hour_ago = time.time() - 3600
    monkeypatch.setattr("limits.storage.memory.time.time", lambda: hour_ago)
    assert until(lambda: guard._too_many("192.0.2.1"))
    until(lambda: guard._too_many("192.0.2.1") is None, 5)


@pytest.mark.parametrize(
    ("allowed", "host", "status"),
    [
        ("", "attacker.example", 200),
        ("adr.example.org", "adr.example.org", 200),
        ("adr.example.org", "attacker.example", 400),
    ],
)
def test_a_service_for_every_address_answers_to_its_given_names_alone(allowed, host, status):
    client = guarded(token=TOKEN, host="0.0.0.0", allowed_hosts=allowed)  # noqa: S104 - not bound
    headers = {"Host": host, "Authorization": f"Bearer {TOKEN}"}
    assert client.get("/v1/tasks", headers=headers).status_code == status


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        ("http://127.0.0.1", 200),
        ("http://127.0.0.1.attacker.example", 403),
        ("http://attacker.example", 403),
    ],
)
def test_pages_of_the_service_alone_may_change_something(origin, status):
    answer = guarded().post("/v1/runs", json={}, headers={"Origin": origin})
    assert answer.status_code == status


@pytest.mark.parametrize(
    ("origin", "has_remedy"),
    [
        ("https://adr.example.org", True),
        ("https://adr.example.org:8443", True),
        ("https://attacker.example", False),
        ("null", False),
    ],
)
def test_a_page_that_a_proxy_serves_under_another_host_is_refused_with_the_remedy(
    origin, has_remedy
):
    client = guarded(allowed_hosts="adr.example.org")
    headers = {"Origin": origin, "Host": "localhost:8000"}
    refused = client.post("/v1/runs", json={}, headers=headers)
    assert refused.status_code == 403
    detail = refused.json()["detail"]
    assert ("the request came for 'localhost:8000'" in detail) == has_remedy
    assert ("nginx: proxy_set_header Host $http_host" in detail) == has_remedy

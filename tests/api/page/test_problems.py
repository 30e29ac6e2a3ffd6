"""Refusals as pages for people and as JSON for programs."""

import pytest
from fastapi import FastAPI, Response
from fastapi.testclient import TestClient

from api import errors
from api.page.problems import Problems

HTML = {"Accept": "text/html,application/xhtml+xml"}


@pytest.fixture
def client():
    app = FastAPI()
    errors.install(app)

    @app.get("/defect")
    def defect() -> None:
        raise ValueError("secret")

    @app.api_route("/locked", methods=["GET", "POST"])
    def locked() -> Response:
        return errors.problem(401, "unauthorized", "there is a token")

    @app.get("/text")
    def text() -> str:
        return "as it is"

    app.add_middleware(Problems)
    return TestClient(app, raise_server_exceptions=False)


def test_a_browser_gets_a_page_and_a_program_gets_json(client):
    page = client.get("/nothing", headers=HTML)
    assert (page.status_code, page.headers["Content-Type"]) == (404, "text/html; charset=utf-8")
    assert "<h1>Not found</h1>" in page.text
    assert client.get("/nothing").json()["status"] == 404


def test_after_a_login_the_page_that_was_asked_for_is_shown(client):
    page = client.get("/locked?id=bench_1&id=bench_2", headers=HTML)
    assert 'name="next" value="/locked?id=bench_1&amp;id=bench_2"' in page.text
    page = client.post("/locked?id=bench_1", headers=HTML)
    assert 'name="next" value="/"' in page.text


def test_a_defect_is_a_page_that_tells_nothing_of_the_inside(client):
    page = client.get("/defect", headers=HTML)
    assert page.status_code == 500
    assert "the service has a defect" in page.text.lower()
    assert "secret" not in page.text


def test_what_is_no_problem_is_left_alone(client):
    assert client.get("/text", headers=HTML).json() == "as it is"

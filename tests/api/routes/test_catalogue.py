"""The catalogue, and the state of the service."""

import json
import sqlite3
from contextlib import closing

import pytest

from adr_service.tasks.catalogue import BUILT_IN
from tests.api.smoke import SMOKE
from tests.service import wait_until_finished

pytestmark = pytest.mark.ray


def test_a_healthy_service_is_ready(http):
    assert http.get("/healthz").json() == {"status": "ok"}
    ready = http.get("/readyz").json()
    assert ready["status"] == "ready"
    assert ready["cores"] == 2
    for address in ("/healthz", "/readyz"):  # some monitors ask for no more than the head
        head = http.head(address)
        assert (head.status_code, head.content) == (200, b"")


def test_while_another_process_holds_the_database_nothing_is_lost(http, service):
    """Longer than writers wait."""
    run = service.client.submit_run({**SMOKE, "method": "prior", "seed": 71})["id"]
    with closing(sqlite3.connect(service.data_dir / "adr.sqlite", isolation_level=None)) as other:
        other.execute("begin immediate")
        refused = http.get("/readyz")
        assert (refused.status_code, refused.json()["title"]) == (503, "database unavailable")
        assert int(refused.headers["Retry-After"]) > 0
        assert http.get(f"/v1/runs/{run}").json()["state"] in ("queued", "running")
    assert http.get("/readyz").json()["status"] == "ready"
    assert wait_until_finished(service.client, run, 120)["state"] == "succeeded"


def test_the_catalogue_lists_tasks_methods_and_presets(http):
    assert {task["name"] for task in http.get("/v1/tasks").json()} == set(BUILT_IN)
    assert "DropoSettings" in json.dumps(http.get("/v1/methods").json())
    assert list(http.get("/v1/presets").json()) == ["smoke", "demo", "quick", "fast", "paper"]


def test_tasks_hide_the_true_parameters(http):
    """The catalogue has no hidden value of a simulated target, but where bounds end at it."""
    tasks = {task["name"]: task for task in http.get("/v1/tasks").json()}
    edges = {name: task["variants"].pop("edge") for name, task in tasks.items()}
    assert "3.534" in json.dumps(edges["hopper"])
    assert tasks["hopper"]["variants"].keys() == {"vanilla", "noisy", "unmodeled", "outside"}
    assert "3.534" not in json.dumps(tasks)

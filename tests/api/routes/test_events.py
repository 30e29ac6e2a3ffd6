"""Events of a run."""

import asyncio
import json

import pytest

from adr_service.specs import RunSpec
from api.routes.events import stream
from db import runs
from db.errors import DatabaseUnavailable
from tests.api.smoke import SMOKE
from tests.api.standins import Service
from tests.db.finished import proceed

ray = pytest.mark.ray


@ray
def test_events_are_paged(http, finished):
    whole = http.get(f"/v1/runs/{finished}/events").json()["items"]
    first = http.get(f"/v1/runs/{finished}/events?limit=2").json()
    rest = http.get(f"/v1/runs/{finished}/events?after={first['next_page_token']}").json()
    assert first["items"] + rest["items"] == whole


@ray
def test_a_stream_has_every_event_to_the_end_of_the_run(service, http):
    run = service.client.submit_run({**SMOKE, "method": "prior", "seed": 79})["id"]
    state = "queued"
    while state not in ("succeeded", "failed"):
        state = http.get(f"/v1/runs/{run}", params={"wait": 20}).json()["state"]
    lines = http.get(f"/v1/runs/{run}/events/stream").text.splitlines()
    ids = [int(line[3:]) for line in lines if line.startswith("id:")]
    stored = http.get(f"/v1/runs/{run}/events").json()["items"]
    assert ids == [each["seq"] for each in stored] == list(range(1, len(ids) + 1))
    bodies = [json.loads(line.removeprefix("data:")) for line in lines if line.startswith("data:")]
    assert bodies[: len(stored)] == stored
    assert [line for line in lines if line.startswith("event:")][-1].split()[1] == "end"
    rest = http.get(f"/v1/runs/{run}/events/stream", headers={"Last-Event-ID": "2"}).text
    assert [line for line in rest.splitlines() if line.startswith("id:")] == [
        f"id: {i}" for i in ids[2:]
    ]


class Database:
    """A database that cannot be read at some of the times that it is asked."""

    def __init__(self, database, unavailable):
        self._database, self._unavailable, self._asked = database, unavailable, 0

    def read(self):
        self._asked += 1
        if self._asked in self._unavailable:
            raise DatabaseUnavailable("too much is read from the database just now")
        return self._database.read()


def streamed(service, run_id, seen=0):
    async def whole():
        return [each async for each in stream(run_id, service, seen)]

    return asyncio.run(whole())


@pytest.mark.parametrize("unavailable", [{1, 2}, {2}, {3, 4}], ids=str)
def test_a_stream_goes_on_after_a_moment_without_a_database(file_database, unavailable):
    run = runs.create_run(file_database, RunSpec.model_validate(SMOKE))
    proceed(file_database, run, most=1)
    undisturbed = streamed(Service(file_database), run.id)
    assert len(undisturbed) > 3
    assert streamed(Service(Database(file_database, unavailable)), run.id) == undisturbed


def test_a_stream_ends_when_its_run_is_deleted(file_database):
    run = runs.create_run(file_database, RunSpec.model_validate(SMOKE))

    async def watch():
        watched = stream(run.id, Service(file_database), 0)
        seen = [await anext(watched)]
        proceed(file_database, run, most=0)
        runs.delete_run(file_database, run.id)
        return seen + [each async for each in watched]

    queued, end = asyncio.run(watch())
    assert (queued.event, end.event, end.data) == ("run_queued", "end", {"state": "deleted"})

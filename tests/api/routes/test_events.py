"""Events of a run."""

import json

import pytest

from tests.api.smoke import SMOKE

pytestmark = pytest.mark.ray


def test_events_are_paged(http, finished):
    whole = http.get(f"/v1/runs/{finished}/events").json()["items"]
    first = http.get(f"/v1/runs/{finished}/events?limit=2").json()
    rest = http.get(f"/v1/runs/{finished}/events?after={first['next_page_token']}").json()
    assert first["items"] + rest["items"] == whole


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

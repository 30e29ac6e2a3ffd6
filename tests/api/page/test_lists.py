"""The pages of robots and criticisms, without Ray."""

import html
import re
from datetime import timedelta

import pytest

from adr_service.events import CriticismFinished
from adr_service.specs import CriticismSpec
from api.page import lists
from api.page import runs as run_page
from db import datasets, runs, visits
from db.clock import SteadyClock
from db.events import append_event
from tests.api.cli.test_verdict_table import CAUSE, VERDICT
from tests.api.standins import Service
from tests.db.leases import LEASE_S, SPEC, START, claim, publish
from tests.recordings import recording


@pytest.fixture
def service(file_database):
    """One whose clock for leases stands, long before the wall clock's time."""
    service = Service(file_database)
    service.orchestrator.clock = SteadyClock(wall=lambda: START, steady=lambda: 0.0)
    return service


@pytest.fixture
def run(service):
    """A run whose visit a robot has claimed."""
    run = runs.create_run(service.database, SPEC)
    publish(service.database, run.id)
    claim(service.database, "robot-7")
    return run.id


def test_the_end_of_a_lease_is_counted_by_the_clock_of_leases(service, run):
    assert f'<td data-value="60">in {LEASE_S:.0f} s</td>' in shown(service, "/robots")
    assert "is claimed by robot-7" in shown(service, f"/runs/{run}")


@pytest.mark.parametrize(("kind", "is_trained"), [("actuator_gain", True), ("sensor_delay", False)])
def test_training_is_offered_on_what_trainings_can_simulate(service, kind, is_trained):
    data = recording("arm", 40)
    stored, _ = datasets.store_dataset(service.database, data.to_npz(), data)
    spec = CriticismSpec.model_validate({"task": "arm", "dataset": stored.id})
    run = runs.create_run(service.database, spec)
    verdict = {**VERDICT, "causes": [{**CAUSE, "kind": kind}]}
    found = CriticismFinished(verdict=verdict, files={"effects.json": "0" * 64})
    append_event(service.database, run.id, found)
    page = shown(service, f"/runs/{run.id}")
    assert (f'action="/runs/{run.id}/train"' in page) == is_trained
    refusal = f"trainings do not simulate effects on commands or in sensors: {kind}.</p>"
    assert (refusal in page) != is_trained


@pytest.mark.parametrize("late_s", [0, 3541])
def test_a_lease_that_has_ended_is_shown_as_free_for_another(service, run, late_s):
    now = START + timedelta(seconds=LEASE_S + late_s)
    service.orchestrator.clock = SteadyClock(wall=lambda: now, steady=lambda: 0.0)
    page = shown(service, "/robots")
    assert ">ended, free for another</td>" in page
    assert ">in -" not in page
    page = shown(service, f"/runs/{run}")
    assert "robot-7’s lease has ended, so it is free for another" in page
    assert "is claimed by" not in page


def test_a_visit_that_was_given_back_names_no_robot_and_no_steps(service):
    run = runs.create_run(service.database, SPEC)
    publish(service.database, run.id)
    task = claim(service.database, "robot-7")
    visits.heartbeat(service.database, task.id, task.lease, 57, START, LEASE_S)
    assert "57 of " in shown(service, "/robots")
    visits.release(service.database, task.id, task.lease)
    page = shown(service, "/robots")
    assert "robot-7" not in page
    assert "57 of " not in page
    assert re.search("It waits for a .*is pending", shown(service, f"/runs/{run.id}"))
    assert "robot-7" not in shown(service, f"/runs/{run.id}")


def shown(service, address):
    answer = service.client(lists.router, run_page.router).get(address)
    assert answer.status_code == 200
    return html.unescape(answer.text)


@pytest.mark.parametrize("name", ["a\x1b[2Jb.npz", "a\u202eb.npz", "x" * 252 + ".npz"])
def test_a_file_with_an_odd_name_is_refused_in_words(service, name):
    answer = service.client(lists.router).post(
        "/criticisms",
        data={"task": "arm", "variant": "vanilla"},
        files={"measurement": (name, recording("arm", 40).to_npz())},
    )
    assert answer.status_code == 422
    page = html.unescape(answer.text)
    assert "the file’s name must be one line of 255 characters at most" in page
    assert "pattern" not in page
    assert not {"\x1b", "\u202e"} & set(page)

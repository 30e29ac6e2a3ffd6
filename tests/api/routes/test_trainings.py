"""Learning curves and policies of a run's trainings."""

import time
from contextlib import closing

import pytest

from adr_service.training.policy import Policy
from api.routes.trainings import training_views
from db import benchmarks, events
from db.session import open_database
from tests.api.smoke import SMOKE
from tests.db.finished import finished_benchmark
from tests.service import wait_until_finished


def test_a_finished_training_says_what_was_moved_and_what_diverged(file_database):
    id = finished_benchmark(file_database, methods=["udr"])
    run = benchmarks.runs_of(file_database, id)[0].id
    records = events.events_of(file_database, run)
    (digest, *_) = [e.event.digest for e in records if e.event.type == "training_evaluated"]
    before = [e for e in records if e.event.key != f"stage_finished:{digest}"]
    moved = [
        (view.digest == digest, view.adjusted_draws, view.diverged_episodes)
        for part in (before, records)
        for view in training_views(file_database, run, part)[:1]
    ]
    assert moved == [(True, None, None), (True, 3, 1)]


def test_a_training_of_which_nothing_is_kept_has_no_link_to_a_policy(file_database, tmp_path):
    """As one that was not finished in a run which came from an archive."""
    run = benchmarks.runs_of(file_database, finished_benchmark(file_database, methods=["udr"]))[0]
    records = events.events_of(file_database, run.id)
    assert all("policy" in each.links for each in training_views(file_database, run.id, records))
    with closing(open_database(f"sqlite:///{tmp_path / 'other.sqlite'}")) as other:
        assert [each.links for each in training_views(other, run.id, records)][:1] == [{}]


@pytest.mark.ray
def test_each_policy_has_a_learning_curve(http, finished):
    trainings = http.get(f"/v1/runs/{finished}/trainings").json()
    assert [[point["steps"] for point in t["curve"]] for t in trainings] == [[300, 600]] * 2
    assert all(training["is_finished"] for training in trainings)
    content = http.get(trainings[0]["links"]["policy"]).content
    assert Policy.from_bytes(content).action_low.tolist() == [-1, -1]


@pytest.mark.ray
def test_a_cancelled_training_keeps_its_curve_and_its_best_policy(service, http):
    long = {**SMOKE, "method": "prior", "seed": 78}
    long["training"] = {"max_steps": 1_000_000, "evaluate_every": 600}
    id = service.client.submit_run(long)["id"]
    while not (trainings := http.get(f"/v1/runs/{id}/trainings").json()):
        time.sleep(0.2)
    service.client.cancel(id)
    assert wait_until_finished(service.client, id, 60)["state"] == "cancelled"
    (training,) = http.get(f"/v1/runs/{id}/trainings").json()
    assert training["curve"][: len(trainings[0]["curve"])] == trainings[0]["curve"]
    assert not training["is_finished"]
    policy = Policy.from_bytes(http.get(training["links"]["policy"]).content)
    assert policy.action_low.tolist() == [-1, -1]

"""Results, costs and policies of a run."""

import re

import pytest

from adr_service.training.policy import Policy

pytestmark = pytest.mark.ray


def test_a_finished_run_has_events_results_and_a_policy(service, http, finished):
    events = http.get(f"/v1/runs/{finished}/events").json()["items"]
    assert [e["seq"] for e in events] == list(range(1, len(events) + 1))
    assert events[0]["event"]["type"] == "run_queued"
    assert events[-1]["event"]["type"] == "run_succeeded"
    rows = service.client.results(finished)["rows"]
    assert [row["target_transitions"] for row in rows] == [0, 20]
    assert "mean nothing" in service.client.results(finished)["note"]
    policy = Policy.from_bytes(service.client.policy(finished))
    assert policy.action_low.tolist() == [-1, -1]


def test_the_cost_lists_every_kind_of_stage(service, finished):
    cost = service.client.cost(finished)
    kinds = {kind["kind"]: kind for kind in cost["kinds"]}
    assert kinds.keys() == {"train_policy", "target_rollout", "infer", "evaluate"}
    assert kinds["train_policy"]["stages"] == 2
    for kind in kinds.values():
        assert 0 < kind["cpu_seconds"] < 2 * kind["seconds"]
        assert kind["preparing_seconds"] < kind["seconds"]


def test_an_unknown_figure_is_refused_with_the_list(http, finished):
    response = http.get(f"/v1/runs/{finished}/figures/curve.svg")
    assert response.status_code == 404
    assert "returns, profile, collection" in response.json()["detail"]


def test_the_papers_of_what_was_run_are_bibtex(service, http, finished):
    response = http.get(f"/v1/runs/{finished}/citations")
    assert response.headers["content-type"].startswith("application/x-bibtex")
    assert response.text == service.client.citations(finished)
    keys = re.findall(r"^@\w+{(\w+),$", response.text, re.MULTILINE)
    assert {"tiboni2022benchmark", "chebotar2019simopt", "haarnoja2018sac"} <= set(keys)
    assert "tsai2021droid" not in keys

"""Metrics for Prometheus."""

import re
from pathlib import Path

import pytest

from api.metrics import _working
from workers.jobs import Activity

pytestmark = pytest.mark.ray


def test_metrics_count_runs_stages_and_visits(http, finished):
    answer = http.get("/metrics")
    assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
    numbers = dict(
        line.rsplit(" ", 1) for line in answer.text.splitlines() if not line.startswith("#")
    )
    assert float(numbers['adr_runs{state="succeeded"}']) >= 1
    assert float(numbers['adr_stages_stored{kind="train_policy"}']) >= 1
    assert float(numbers['adr_target_tasks{of="simulated",state="done"}']) >= 1
    for rare in ('adr_runs{state="cancelled"}', 'adr_target_tasks{of="robots",state="failed"}'):
        assert rare in numbers  # from the first scrape on, so that the first one is a rise
    assert float(numbers["adr_cores"]) == 2
    assert float(numbers["adr_disk_free_bytes"]) > 0


def test_the_dashboard_shows_every_metric(http):
    shown = (Path(__file__).parents[2] / "docs/monitoring/dashboard.json").read_text()
    asked = set(re.findall(r"\badr_\w+", shown))
    assert asked == set(re.findall(r"^# TYPE (adr_\w+)", http.get("/metrics").text, re.M))


def test_a_methods_own_steps_are_no_steps_of_a_training():
    common = {"digest": "d", "state": "running", "attempt": 1, "fraction": 0.5}
    common |= {"actor": None, "actor_id": None, "pid": None, "started_by": "run_1"}
    activities = [
        Activity(kind="infer", seconds=10.0, facts={"steps": "many"}, **common),
        Activity(kind="train_policy", seconds=10.0, facts={"steps": 50}, **common),
    ]
    *_, speed = _working(activities)
    assert speed.samples[0].value == 5.0

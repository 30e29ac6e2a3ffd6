"""Metrics for Prometheus."""

import re
from pathlib import Path

import pytest

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

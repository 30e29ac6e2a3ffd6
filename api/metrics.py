"""/metrics for Prometheus: what waits, what runs, how fast, and how long the database takes.

Counted when it is asked for, from the database and the dispatcher; nothing is kept in between.
"""

import time
from collections.abc import Iterable
from datetime import UTC, datetime

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from api.service import Service
from db import counts as store

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


def exposition(service: Service) -> bytes:
    """All metrics in Prometheus' text format."""
    registry = CollectorRegistry()
    registry.register(_Now(service))
    return generate_latest(registry)


class _Now(Collector):
    def __init__(self, service: Service):
        self._service = service

    def collect(self) -> Iterable[Metric]:
        now, began = datetime.now(UTC), time.perf_counter()
        counted = store.count(self._service.database)
        read_s = time.perf_counter() - began
        runs = GaugeMetricFamily("adr_runs", "Runs by state.", labels=["state"])
        for state, number in counted.runs.items():
            runs.add_metric([state], number)
        yield runs
        stored = GaugeMetricFamily("adr_stages_stored", "Stages with a result.", labels=["kind"])
        for kind, number in counted.stages.items():
            stored.add_metric([kind], number)
        yield stored
        yield from self._in_the_works()
        tasks = GaugeMetricFamily(
            "adr_target_tasks", "Visits to targets by state and claimant.", labels=["state", "of"]
        )
        for (state, external), number in counted.tasks.items():
            tasks.add_metric([state, "robots" if external else "simulated"], number)
        yield tasks
        ages = GaugeMetricFamily(
            "adr_lease_age_seconds", "Since a robot claimed its task.", labels=["task", "worker"]
        )
        for id, worker, claimed_at in counted.claims:
            ages.add_metric([id, worker], (now - claimed_at).total_seconds())
        yield ages
        yield GaugeMetricFamily("adr_cores", "Of the cluster.", self._service.orchestrator.cores)
        yield GaugeMetricFamily(
            "adr_database_read_seconds", "How long counting all this took.", read_s
        )
        yield GaugeMetricFamily(
            "adr_disk_free_bytes", "Where results are.", self._service.free_disk()
        )

    def _in_the_works(self) -> Iterable[Metric]:
        activities = self._service.orchestrator.activities()
        works = GaugeMetricFamily(
            "adr_stages", "Stages that wait or run, by kind.", labels=["kind", "state"]
        )
        found: dict[tuple[str, str], int] = {}
        for activity in activities:
            key = (activity.kind, activity.state)
            found[key] = found.get(key, 0) + 1
        for key, number in found.items():
            works.add_metric(key, number)
        yield works
        steps = [(float(a.facts["steps"]), a.seconds) for a in activities if "steps" in a.facts]
        yield GaugeMetricFamily(
            "adr_environment_steps_per_second",
            "Of the trainings that go on, each since it began.",
            sum(done / seconds for done, seconds in steps if seconds > 0),
        )

"""/metrics for Prometheus: counts of runs, stages and visits, their speed, and the database's.

Each request counts them anew, from the database and the dispatcher.
"""

import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

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
        now, began = self._service.orchestrator.clock.now(), time.perf_counter()
        counted = store.count(self._service.database)
        read_s = time.perf_counter() - began
        activities = self._service.orchestrator.activities()
        steps = [(float(a.facts["steps"]), a.seconds) for a in activities if "steps" in a.facts]
        yield _gauge(
            "adr_runs", "Runs by state.", ["state"], {(s,): n for s, n in counted.runs.items()}
        )
        yield _gauge(
            "adr_stages_stored",
            "Stages with a result.",
            ["kind"],
            {(kind,): n for kind, n in counted.stages.items()},
        )
        yield _gauge(
            "adr_stages",
            "Stages that wait or run, by kind.",
            ["kind", "state"],
            Counter((activity.kind, activity.state) for activity in activities),
        )
        yield GaugeMetricFamily(
            "adr_environment_steps_per_second",
            "Of the trainings that go on, each since it began.",
            sum(done / seconds for done, seconds in steps if seconds > 0),
        )
        yield _gauge(
            "adr_target_tasks",
            "Visits to targets by state and claimant.",
            ["state", "of"],
            {(s, "robots" if e else "simulated"): n for (s, e), n in counted.visits.items()},
        )
        yield _gauge(
            "adr_lease_age_seconds",
            "Since a robot claimed its task.",
            ["task", "worker"],
            {(id, worker): (now - at).total_seconds() for id, worker, at in counted.claims},
        )
        yield GaugeMetricFamily("adr_cores", "Of the cluster.", self._service.orchestrator.cores)
        yield GaugeMetricFamily(
            "adr_database_read_seconds", "How long counting all this took.", read_s
        )
        yield GaugeMetricFamily(
            "adr_disk_free_bytes", "Where results are.", self._service.free_disk()
        )


def _gauge(
    name: str, text: str, labels: Sequence[str], values: Mapping[tuple[str, ...], float]
) -> Metric:
    """Return a gauge from numbers by the values of their labels."""
    gauge = GaugeMetricFamily(name, text, labels=labels)
    for key, value in values.items():
        gauge.add_metric(key, value)
    return gauge

"""/metrics for Prometheus: counts of runs, stages and visits, their speed, and the database's.

Each request counts them anew, from the database and the dispatcher.
"""

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from adr_service.events import RunState
from adr_service.stages.train_policy import TrainPolicy
from api.service import Service
from db import counts as store
from db.counts import Counts
from db.models import VisitState
from workers.jobs import Activity

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
        counts = store.count(self._service.database)
        read_s = time.perf_counter() - began
        yield from _counted(counts, now)
        yield from _working(self._service.orchestrator.activities())
        yield GaugeMetricFamily("adr_cores", "Of the cluster.", self._service.orchestrator.cores)
        yield GaugeMetricFamily(
            "adr_dispatcher_silent_seconds",
            "For which it has waited for Ray, or for the database to write.",
            self._service.orchestrator.silent_s,
        )
        yield GaugeMetricFamily(
            "adr_database_read_seconds", "How long counting all this took.", read_s
        )
        yield GaugeMetricFamily(
            "adr_disk_free_bytes",
            "Where results are; of several disks, on the one with fewest.",
            self._service.free_disk(),
        )


def _counted(counts: Counts, now: datetime) -> Iterator[Metric]:
    """Yield metrics of the rows in the database."""
    # states without any have a zero: a rise from nothing at all does not show
    runs = {(str(state),): 0 for state in RunState}
    runs |= {(state,): number for state, number in counts.runs.items()}
    yield _gauge("adr_runs", "Runs by state.", ["state"], runs)
    stages = {(kind,): number for kind, number in counts.stages.items()}
    yield _gauge("adr_stages_stored", "Stages with a result.", ["kind"], stages)
    claimants = {True: "robots", False: "simulated"}
    visits = {(str(state), of): 0 for state in VisitState for of in claimants.values()}
    visits |= {
        (state, claimants[external]): number for (state, external), number in counts.visits.items()
    }
    text = "Visits to targets by state and claimant."
    yield _gauge("adr_target_tasks", text, ["state", "of"], visits)
    ages = {(id, worker): (now - at).total_seconds() for id, worker, at in counts.claims}
    text = "Since a robot claimed its task."
    yield _gauge("adr_lease_age_seconds", text, ["task", "worker"], ages)


def _working(activities: Sequence[Activity]) -> Iterator[Metric]:
    """Yield metrics of the stages that wait or run."""
    states = Counter((activity.kind, activity.state) for activity in activities)
    yield _gauge("adr_stages", "Stages that wait or run, by kind.", ["kind", "state"], states)
    trainings = [a for a in activities if a.kind == TrainPolicy.kind and "steps" in a.facts]
    yield GaugeMetricFamily(
        "adr_environment_steps_per_second",
        "Of the trainings that go on, each since it began.",
        sum(a.facts["steps"] / a.seconds for a in trainings if a.seconds > 0),
    )


def _gauge(
    name: str, text: str, labels: Sequence[str], values: Mapping[tuple[str, ...], float]
) -> Metric:
    """Return a gauge from numbers by the values of their labels."""
    gauge = GaugeMetricFamily(name, text, labels=labels)
    for key, value in values.items():
        gauge.add_metric(key, value)
    return gauge

"""Benchmarks in a database whose runs have happened, with canned results."""

from adr_service.events import RunStarted, RunStopped, RunSucceeded
from adr_service.programs import run
from adr_service.stages.base import events_of
from db import benchmarks
from db.events import append_event
from db.runs import resubmit
from tests.contracts.canned import canned
from tests.db.rows import EXECUTION, benchmark_spec
from workers.results import DatabaseResults, Outcome


class Interrupted(Exception):
    """The stages of a test have answered as often as they should."""


class CommittedStages:
    """Stages whose results are canned ones, and are stored as the service stores them."""

    def __init__(self, database, run_id, most):
        self.run_id, self._results, self._left = run_id, DatabaseResults(database), most

    def all(self, stages):
        results = []
        for stage in stages:
            stored = self._results.find(stage, self.run_id)
            if stored is None:
                if self._left == 0:
                    raise Interrupted
                self._left -= 1
                stored = canned(stage)
                self._results.commit([Outcome(stage, stored, EXECUTION, None, [self.run_id])])
            results.append(stage.read(stored))
            yield from events_of(stage, results[-1])
        return results

    def run(self, stage):
        return (yield from self.all([stage]))[0]


def proceed(database, record, most=10**9):
    """Run a queued run over at most so many new stages, and stop it there."""
    append_event(database, record.id, RunStarted(submission=record.submission))
    try:
        for event in run(record.spec, CommittedStages(database, record.id, most)):
            append_event(database, record.id, event)
        append_event(database, record.id, RunSucceeded())
    except Interrupted:
        append_event(database, record.id, RunStopped(submission=record.submission))


def finished_benchmark(database, most=10**9, **changes):
    """The id of a benchmark whose runs have come so far."""
    id = benchmarks.create_benchmark(database, benchmark_spec(**changes)).id
    for record in benchmarks.runs_of(database, id):
        proceed(database, record, most)
    return id


def go_on(database, id):
    """Resume the runs of a benchmark, and finish them."""
    for record in benchmarks.runs_of(database, id):
        if record.state.is_resumable:
            proceed(database, resubmit(database, record.id))

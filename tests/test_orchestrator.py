"""Which runs get a thread, and when; their programs are ours, and need no Ray."""

import sqlite3
import threading
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from adr_service.errors import InvalidInput
from adr_service.specs import BenchmarkSpec, RunSpec
from db import runs
from tests.service import until
from workers.cluster import ClusterUnavailable, RayOptions
from workers.orchestrator import RUNS_AT_ONCE, Orchestrator

SPEC = RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke"})


@pytest.fixture
def orchestrator(file_database):
    return Orchestrator(file_database, RayOptions())  # it is not started


def test_a_run_whose_end_cannot_be_stored_yet_is_not_begun_again(
    file_database, orchestrator, tmp_path: Path, monkeypatch
):
    file = tmp_path / "adr.sqlite"
    begun = []
    with closing(sqlite3.connect(file, isolation_level=None, check_same_thread=False)) as other:

        def program(*_):
            begun.append(1)
            other.execute("begin immediate")
            raise InvalidInput("nothing can be computed")

        monkeypatch.setattr("workers.orchestrator.run", program)
        record = runs.create_run(file_database, SPEC)
        for _ in range(3):
            orchestrator.adopt()
            until(lambda: begun)
        other.execute("rollback")
        until(lambda: runs.get_run(file_database, record.id).state == "failed")
        assert begun == [1]
        orchestrator.submit(record)  # as it was read before it ended
        again = runs.resubmit(file_database, record.id)
        orchestrator.submit(again)
        until(lambda: len(begun) == 2)
        other.execute("rollback")
        until(lambda: runs.get_run(file_database, record.id).state == "failed")
    assert begun == [1, 1]


def test_a_service_that_stops_begins_no_run_that_waited_for_a_thread(
    file_database, monkeypatch, caplog
):
    """Seven thousand queued runs became "running", and wrote a traceback each, at a SIGTERM."""
    begun, stopping = threading.Semaphore(0), threading.Event()

    def program(*_):
        begun.release()
        stopping.wait(60)
        raise ClusterUnavailable("the dispatcher has stopped; restart the service")
        yield

    monkeypatch.setattr("workers.orchestrator.run", program)
    orchestrator = Orchestrator(file_database, RayOptions())
    monkeypatch.setattr(orchestrator._dispatcher, "close", stopping.set)
    for _ in range(3 * RUNS_AT_ONCE):
        orchestrator.submit(runs.create_run(file_database, SPEC))
    for _ in range(RUNS_AT_ONCE):
        assert begun.acquire(timeout=60)
    orchestrator.close()
    states = [run.state for run in runs.list_runs(file_database, limit=None)]
    assert states.count("running") == RUNS_AT_ONCE
    assert states.count("queued") == 2 * RUNS_AT_ONCE
    assert "Traceback" not in caplog.text


def test_cancelling_many_runs_stops_them_in_batches(file_database, monkeypatch):
    waiting = threading.Event()
    monkeypatch.setattr("workers.orchestrator.run", lambda *_: iter([waiting.wait(60)][:0]))
    orchestrator = Orchestrator(file_database, RayOptions())
    given = {"tasks": ["arm"], "methods": ["prior"], "references": False, "preset": "smoke"}
    spec = BenchmarkSpec.model_validate({**given, "seeds": list(range(400))})
    benchmark = runs.create_benchmark(file_database, spec).id
    for run in runs.runs_of(file_database, benchmark):
        orchestrator.submit(run)
    with counted(file_database) as transactions:
        orchestrator.cancel(*runs.request_cancel_all(file_database, benchmark))
        until(lambda: cancelled(file_database, benchmark) == 400 - RUNS_AT_ONCE)
    assert transactions.count("append_events") == 4
    assert transactions.count("request_cancel_all") == 1
    waiting.set()
    orchestrator.close()


@contextmanager
def counted(database):
    """The names of the transactions that are begun meanwhile."""
    names, write = [], database.write
    database.write = lambda name: names.append(name) or write(name)
    yield names
    database.write = write


def cancelled(database, benchmark):
    return runs.states_of(database, [benchmark])[benchmark].get("cancelled", 0)

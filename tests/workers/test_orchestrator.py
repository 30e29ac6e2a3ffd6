"""Threads of runs: when one begins, and how it ends. The programs are the tests' own; no Ray."""

import logging
import sqlite3
import threading
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from adr_service.errors import AdrError, FailureCode, InvalidInput, RunCancelled, StageFailed
from adr_service.events import RunFailed
from adr_service.npz import write_arrays
from adr_service.specs import BenchmarkSpec, RunSpec
from db import benchmarks, events, runs, visits
from db.errors import DatabaseUnavailable
from db.visits import LeaseLost
from tests.db import leases
from tests.planted import recorded, waving_policy
from tests.service import until
from tests.stages.examples import episode
from workers.cluster import ClusterUnavailable, RayOptions
from workers.orchestrator import RUNS_AT_ONCE, Orchestrator

SPEC = RunSpec.model_validate({"task": "arm", "method": "prior", "preset": "smoke"})


def test_a_run_whose_end_cannot_be_stored_yet_is_not_begun_again(file_database, tmp_path: Path):
    file = tmp_path / "adr.sqlite"
    begun = []
    with closing(sqlite3.connect(file, isolation_level=None, check_same_thread=False)) as other:

        def program(*_):
            begun.append(1)
            other.execute("begin immediate")
            raise InvalidInput("nothing can be computed")

        orchestrator = Orchestrator(file_database, RayOptions(), program)  # it is not started
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


def test_a_service_that_stops_begins_no_run_that_waited_for_a_thread(file_database, caplog):
    """Seven thousand queued runs became "running", and wrote a traceback each, at a SIGTERM."""
    begun = threading.Semaphore(0)

    def program(spec, stages, recording):
        begun.release()
        until(stages.is_cancelled)  # as it is once the service stops
        raise ClusterUnavailable("the dispatcher has stopped; restart the service")
        yield

    orchestrator = Orchestrator(file_database, RayOptions(), program)
    for _ in range(3 * RUNS_AT_ONCE):
        orchestrator.submit(runs.create_run(file_database, SPEC))
    for _ in range(RUNS_AT_ONCE):
        assert begun.acquire(timeout=60)
    orchestrator.close()
    states = [run.state for run in runs.list_runs(file_database, limit=None)]
    assert states.count("running") == RUNS_AT_ONCE
    assert states.count("queued") == 2 * RUNS_AT_ONCE
    assert "Traceback" not in caplog.text


def test_cancelling_many_runs_stops_them_in_batches(file_database):
    waiting = threading.Event()

    def program(*_):
        waiting.wait(60)
        return iter([])

    orchestrator = Orchestrator(file_database, RayOptions(), program)
    given = {"tasks": ["arm"], "methods": ["prior"], "references": False, "preset": "smoke"}
    spec = BenchmarkSpec.model_validate({**given, "seeds": list(range(400))})
    benchmark = benchmarks.create_benchmark(file_database, spec).id
    for run in benchmarks.runs_of(file_database, benchmark):
        orchestrator.submit(run)
    with counted(file_database) as transactions:
        orchestrator.cancel(*benchmarks.request_cancel_all(file_database, benchmark))
        until(lambda: cancelled(file_database, benchmark) == 400 - RUNS_AT_ONCE)
    assert transactions.count("append_events") == 4
    assert transactions.count("request_cancel_all") == 1
    waiting.set()
    orchestrator.close()


def test_a_run_without_a_thread_can_be_cancelled(file_database):
    """Its submission was stored, and the answer to that was lost."""

    def program(spec, stages, recording):
        until(stages.is_cancelled)
        raise RunCancelled
        yield

    orchestrator = Orchestrator(file_database, RayOptions(), program)
    run = runs.create_run(file_database, SPEC)
    orchestrator.cancel(runs.request_cancel(file_database, run.id))
    until(lambda: runs.get_run(file_database, run.id).state == "cancelled")
    orchestrator.close()


def test_an_upload_is_not_read_before_its_lease(database):
    """33 kB of somebody without a lease cost half a gigabyte."""
    leases.publish(database, runs.create_run(database, leases.SPEC).id)
    task = leases.claim(database, "a")
    orchestrator = Orchestrator(database, RayOptions())
    with pytest.raises(LeaseLost):
        orchestrator.complete_task(task.id, "another lease", b"not an npz")
    with pytest.raises(InvalidInput, match="not a readable"):
        orchestrator.complete_task(task.id, task.lease, b"not an npz")


def test_a_rollout_that_is_too_short_for_its_method_is_not_stored(database):
    """Stored, it would make the run fail at every resume."""
    given = {"task": "arm", "preset": "smoke", "target": {"kind": "external"}}
    method = {"name": "dropo", "steps": 10}
    run = runs.create_run(database, RunSpec.model_validate({**given, "method": method}))
    leases.publish(database, run.id)
    task, orchestrator = leases.claim(database, "a"), Orchestrator(database, RayOptions())

    def upload(steps):
        data = recorded(waving_policy(), episodes=1, steps=steps)
        content = write_arrays({**data.to_arrays(), "rewards": np.zeros(len(data))})
        return orchestrator.complete_task(task.id, task.lease, content)

    with pytest.raises(InvalidInput, match="has 9 transitions; dropo with steps = 10 learns from"):
        upload(9)
    assert upload(10).state == "done"


def test_a_rollout_that_cannot_be_smoothed_is_not_stored_for_a_method_that_smooths(database):
    """A client's next observations may be readings of their own: smoothing refuses them later."""
    given = {"task": "arm", "preset": "smoke", "target": {"kind": "external"}}
    run = runs.create_run(database, RunSpec.model_validate({**given, "method": "dropo_smoothed"}))
    leases.publish(database, run.id)
    task, orchestrator = leases.claim(database, "a"), Orchestrator(database, RayOptions())
    arrays = recorded(waving_policy(), episodes=1, steps=10).to_arrays()
    arrays["rewards"] = np.zeros(10)
    again = {**arrays, "next_observations": arrays["next_observations"] + 1e-9}
    with pytest.raises(InvalidInput, match="smoothing needs each next observation"):
        orchestrator.complete_task(task.id, task.lease, write_arrays(again))
    content = write_arrays(arrays)
    assert orchestrator.complete_task(task.id, task.lease, content).state == "done"


def test_one_of_several_random_episodes_may_be_shorter_than_its_method_needs(database):
    """The last of them is asked for no more than is still missing."""
    given = {"task": "arm", "preset": "smoke", "target": {"kind": "external"}}
    given |= {"method": {"name": "dropo", "steps": 10}, "collector": "random_matched"}
    run = runs.create_run(database, RunSpec.model_validate(given))
    leases.publish(database, run.id)
    task, orchestrator = leases.claim(database, "a"), Orchestrator(database, RayOptions())
    data = recorded(waving_policy(), episodes=1, steps=3)
    content = write_arrays({**data.to_arrays(), "rewards": np.zeros(len(data))})
    assert orchestrator.complete_task(task.id, task.lease, content).state == "done"


def without_answer(monkeypatch, name):
    """Let a function of `visits` fail after its commit; returns it as it was."""
    stores = getattr(visits, name)

    def failing(*given):
        stores(*given)
        raise DatabaseUnavailable("it failed")

    monkeypatch.setattr(visits, name, failing)
    return stores


def test_an_episode_that_was_stored_without_an_answer_reaches_its_run(database, monkeypatch):
    """The server failed between its commit and its answer."""
    leases.publish(database, runs.create_run(database, leases.SPEC).id)
    now = datetime.now(UTC)
    task, arrived = leases.claim(database, "a", now), []
    orchestrator = Orchestrator(database, RayOptions())
    monkeypatch.setattr(orchestrator._dispatcher, "arrived", arrived.append)
    without_answer(monkeypatch, "complete")
    data = recorded(waving_policy(), episodes=1, steps=task.inputs["transitions"])
    content = write_arrays({**data.to_arrays(), "rewards": np.zeros(len(data))})
    with pytest.raises(DatabaseUnavailable):
        orchestrator.complete_task(task.id, task.lease, content)
    assert arrived == [task.digest]
    assert visits.get_visit(database, task.id).state == "done"


def test_a_failure_that_was_stored_without_an_answer_reaches_its_run(database, monkeypatch):
    """Its thread waited for ever, though the run had failed."""
    leases.publish(database, runs.create_run(database, leases.SPEC).id)
    task, arrived = leases.claim(database, "a", datetime.now(UTC)), []
    orchestrator = Orchestrator(database, RayOptions())
    monkeypatch.setattr(orchestrator._dispatcher, "arrived", arrived.append)
    fail = without_answer(monkeypatch, "fail")
    with pytest.raises(DatabaseUnavailable):
        orchestrator.fail_task(task.id, task.lease, "the gripper is broken")
    assert arrived == [task.digest]
    assert visits.get_visit(database, task.id).state == "failed"
    monkeypatch.setattr(visits, "fail", fail)
    assert orchestrator.fail_task(task.id, task.lease, "the gripper is broken").state == "failed"


class LongWinded(AdrError):
    code = "an_error" * 11


class Numbered(AdrError):
    code = 7


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InvalidInput("no such gripper"), "invalid_input"),
        (StageFailed("train_policy", FailureCode.WORKER_LOST, "lost"), "worker_lost"),
        (ZeroDivisionError("a defect"), "internal"),
        (RuntimeError("a NUL \0, which PostgreSQL cannot store"), "internal"),
        (RuntimeError("a name \udcff that is no UTF-8"), "internal"),
        (LongWinded("of a user"), "internal"),  # PostgreSQL has 80 characters for a code
        (Numbered("of another user"), "7"),
        (SystemExit("a method's module parses the command line"), "internal"),
    ],
)
def test_an_error_of_the_program_is_on_the_runs_record(database, error, code, caplog):
    caplog.set_level(logging.CRITICAL, "workers.orchestrator")  # xdist carries UTF-8 alone

    def program(*_):
        raise error
        yield

    orchestrator = Orchestrator(database, RayOptions(), program)
    record = runs.create_run(database, SPEC)
    orchestrator.submit(record)
    until(lambda: runs.get_run(database, record.id).is_finished)
    ended = runs.get_run(database, record.id)
    assert (ended.state, ended.error_code) == ("failed", code)
    stored = str(error).replace("\0", "\\0").replace("\udcff", "\\udcff")
    assert stored in ended.error_message
    orchestrator.close()


def test_a_visit_that_no_robot_can_do_fails_its_run_in_one_transaction(database):
    """A service that ends before its program knows offers the visit to no other robot."""
    orchestrator = Orchestrator(database, RayOptions())
    record = runs.create_run(database, SPEC)
    runs.begin(database, record)
    with database.write("test") as session:
        visits.publish(session, episode(record.id), record.id, orchestrator.clock.now())
    task = visits.claim(database, "lab", ["arm"], orchestrator.clock.now(), 60.0)
    orchestrator.fail_task(task.id, task.lease, "the gripper is broken")
    ended = runs.get_run(database, record.id)
    assert (ended.state, ended.error_code) == ("failed", "target_failed")
    assert ended.error_message == "target_episode: the gripper is broken"
    assert visits.get_visit(database, task.id).error == "the gripper is broken"
    orchestrator.close()


def test_a_run_that_was_resumed_keeps_what_it_asked_for_when_its_former_thread_ends(database):
    """The visit's failure is stored before the thread that waits for it has heard of it."""
    waiting, let_go = threading.Event(), threading.Event()

    def program(spec, stages, recording):
        waiting.set()
        assert let_go.wait(20)
        raise StageFailed("target_episode", FailureCode.TARGET_FAILED, "the gripper is broken")
        yield

    orchestrator = Orchestrator(database, RayOptions(), program)
    withdrawn = []
    orchestrator._dispatcher.withdraw = withdrawn.append
    record = runs.create_run(database, SPEC)
    orchestrator.submit(record)
    assert waiting.wait(20)
    failed = RunFailed(submission=1, code="target_failed", message="the gripper is broken")
    with database.write("test") as session:
        events.append_to_all(session, [record.id], [failed])
    waiting.clear()
    orchestrator.submit(runs.resubmit(database, record.id))
    assert waiting.wait(20)
    let_go.set()
    until(lambda: runs.get_run(database, record.id).state == "failed")
    until(lambda: not orchestrator._live)
    assert withdrawn == [record.id]  # by its last thread alone
    orchestrator.close()


@contextmanager
def counted(database):
    """The names of the transactions that are begun meanwhile."""
    names, write = [], database.write
    database.write = lambda name: names.append(name) or write(name)
    yield names
    database.write = write


def cancelled(database, benchmark):
    return benchmarks.states_of(database, [benchmark])[benchmark].get("cancelled", 0)

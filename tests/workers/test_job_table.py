"""The table of jobs on one thread, without Ray: sharing, attempts, and a database in trouble."""

import logging
from concurrent.futures import Future
from dataclasses import replace

import pytest

from adr_service.errors import RunCancelled, StageFailed
from adr_service.progress import Checkpoint
from adr_service.stages.base import StageResult
from tests.db.rows import EXECUTION
from tests.stages.examples import criticism, episode, rollout, training
from tests.workers.stores import Store
from workers import results
from workers.actors import Failed, Finished, Stopped
from workers.heartbeats import SignOfLife
from workers.job_table import MAX_ATTEMPTS, JobTable

RESULT = StageResult({"x": 1}, {"policy": b"weights"})
TRAINING, EPISODE = training(), episode()


class Table:
    """A table with its store."""

    def __init__(self):
        self.store = Store()
        self.jobs = JobTable(self.store)

    def ask(self, stage, run_id="run_a"):
        future = Future()
        self.jobs.accept(stage, run_id, future)
        return future

    def start(self):
        """Begin the first job that waits for a core."""
        job = self.jobs.ready()[0]
        assert self.jobs.begin([job], ["actor"]) == [True]
        job.place(None, object())
        return job

    def finish(self, job):
        self.end(job, Finished(RESULT, replace(EXECUTION, attempt=job.attempt)))

    def end(self, job, ending):
        job.leave()
        self.jobs.end([(job, ending)])


@pytest.fixture
def table():
    return Table()


@pytest.fixture
def at_once(monkeypatch):
    """Retry at once after the database could not be used."""
    monkeypatch.setattr(results, "RETRY_S", 0.0)
    monkeypatch.setattr("workers.jobs.RETRY_S", 0.0)


def test_equal_stages_are_one_job_with_one_result(table):
    futures = [table.ask(TRAINING, run_id) for run_id in ("run_a", "run_b", "run_a")]
    table.finish(table.start())
    assert [future.result(0) for future in futures] == [RESULT] * 3
    assert table.store.commits == [(TRAINING.digest, 1, "run_a", ["run_a", "run_b"])]
    assert len(table.jobs) == 0


def test_a_stored_result_needs_no_job(table):
    table.store.results[TRAINING.digest] = RESULT
    assert table.ask(TRAINING).result(0) == RESULT
    assert len(table.jobs) == 0


def test_light_stages_come_first_and_equal_ones_in_order(table):
    stages = [training(1), criticism(2), training(3), criticism(4)]
    visit = rollout()
    for stage in [*stages, visit]:
        table.ask(stage)
    first, second, third, fourth = stages
    assert [job.stage for job in table.jobs.ready()] == [visit, second, fourth, first, third]


def test_a_robots_episode_waits_for_no_core(table):
    future = table.ask(EPISODE)
    assert table.jobs.ready() == []
    table.jobs.arrived(EPISODE.digest)  # its result was deleted, or is another's
    assert not future.done()
    table.store.results[EPISODE.digest] = RESULT
    table.jobs.arrived(EPISODE.digest)
    assert future.result(0) == RESULT


def test_an_episode_that_is_asked_for_again_is_offered_again(table, monkeypatch):
    """The run had failed, which withdrew its visits, and goes on before its old wait has ended."""
    offered, find = [], table.store.find
    monkeypatch.setattr(table.store, "find", lambda *asked: offered.append(asked) or find(*asked))
    futures = [table.ask(EPISODE) for _ in range(2)]
    assert offered == [(EPISODE, "run_a")] * 2
    table.store.results[EPISODE.digest] = RESULT
    table.jobs.arrived(EPISODE.digest)
    assert [future.result(0) for future in futures] == [RESULT] * 2


def test_every_ending_of_a_stage_has_a_line_in_the_log(table, caplog):
    caplog.set_level(logging.INFO)
    table.ask(TRAINING)
    table.finish(table.start())
    table.ask(criticism())
    table.end(table.start(), Failed("unknown_name", "there is no task 'x'"))
    mine = [line for line in caplog.records if line.name == "workers.job_table"]
    assert [(line.getMessage(), line.kind, line.stage, line.attempt) for line in mine] == [
        ("stage finished", "train_policy", TRAINING.digest, 1),
        ("stage failed: criticise: there is no task 'x'", "criticise", criticism().digest, 1),
    ]


def test_a_refused_episode_fails_with_the_robots_message(table):
    future = table.ask(EPISODE)
    table.jobs.refused(EPISODE.digest, "the gripper is broken")
    with pytest.raises(StageFailed, match="the gripper is broken") as failed:
        future.result(0)
    assert failed.value.cause == "target_failed"


def test_a_running_stage_is_unwanted_only_once_no_run_waits(table):
    table.ask(TRAINING, "run_a")
    table.ask(TRAINING, "run_b")
    job = table.start()
    table.jobs.withdraw("run_a")
    assert table.jobs.unwanted() == set()
    assert job.unwanted_since is None
    table.jobs.withdraw("run_b")
    assert table.jobs.unwanted() == {TRAINING.digest}
    assert job.unwanted_since is not None
    table.end(job, Stopped())
    assert len(table.jobs) == 0
    assert table.store.dropped == [TRAINING.digest]


def test_a_stage_that_is_wanted_again_while_it_stops_gets_another_turn(table):
    table.ask(TRAINING, "run_a")
    job = table.start()
    table.jobs.withdraw("run_a")
    assert job.unwanted_since is not None
    again = table.ask(TRAINING, "run_b")
    assert table.jobs.unwanted() == set()
    assert job.unwanted_since is None
    table.end(job, Stopped())
    table.finish(table.start())
    assert again.result(0) == RESULT
    assert table.store.commits == [(TRAINING.digest, 2, "run_a", ["run_b"])]


def test_a_waiting_stage_that_no_run_wants_leaves_at_once(table):
    table.ask(TRAINING)
    table.jobs.withdraw("run_a")
    assert len(table.jobs) == 0
    assert table.store.dropped == []


def test_a_claim_whose_answer_was_lost_is_dropped_with_its_job(table):
    table.ask(TRAINING)
    table.store.refusals = 1
    assert table.jobs.begin(table.jobs.ready(), ["actor"]) == [False]
    table.jobs.withdraw("run_a")
    assert table.store.dropped == [TRAINING.digest]


def test_three_lost_processes_fail_the_stage(table):
    future = table.ask(TRAINING)
    for attempt in range(1, MAX_ATTEMPTS + 1):
        assert not future.done()
        job = table.start()
        assert job.attempt == attempt
        job.leave()
        table.jobs.lose(job, "killed")
    with pytest.raises(StageFailed, match="lost 3 times; last: killed") as failed:
        future.result(0)
    assert failed.value.cause == "worker_lost"


def test_a_failure_reaches_every_run_and_is_not_stored(table):
    futures = [table.ask(TRAINING, run_id) for run_id in ("run_a", "run_b")]
    table.end(table.start(), Failed("unknown_name", "there is no task 'x'"))
    for future in futures:
        with pytest.raises(StageFailed, match="there is no task 'x'"):
            future.result(0)
    assert table.store.results == {}


def test_a_result_that_cannot_be_stored_fails_its_stage_alone(table):
    unlucky, lucky = table.ask(TRAINING, "run_unlucky"), table.ask(criticism(), "run_b")
    for _ in range(2):
        table.finish(table.start())
    with pytest.raises(StageFailed, match="the database refused: no space left") as failed:
        unlucky.result(0)
    assert failed.value.cause == "not_stored"
    assert lucky.result(0) == RESULT


def test_a_result_that_cannot_be_stored_fails_alone_also_among_several(table, caplog):
    futures = [table.ask(training(seed), "run_b") for seed in range(2)]
    unlucky = table.ask(criticism(), "run_unlucky")
    jobs = [table.start() for _ in range(3)]
    for job in jobs:
        job.leave()
    finished = Finished(RESULT, EXECUTION)
    table.jobs.end([(job, finished) for job in jobs])
    assert [future.result(0) for future in futures] == [RESULT] * 2
    with pytest.raises(StageFailed, match="no space left"):
        unlucky.result(0)
    blamed = {getattr(record, "run", None) for record in caplog.records if record.exc_info}
    assert blamed == {None, "run_unlucky"}


def test_a_request_waits_for_a_database_that_cannot_be_used_just_now(table, at_once):
    table.store.refusals = 1
    future = table.ask(TRAINING)
    assert len(table.jobs) == 0
    table.jobs.retries.run_due()
    table.store.refusals = 1
    assert table.jobs.begin(table.jobs.ready(), ["actor"]) == [False]
    job = table.start()
    table.store.refusals = 1
    table.finish(job)
    assert not future.done()
    assert table.jobs.running() == table.jobs.ready() == []  # it is computed, not stored
    table.jobs.retries.run_due()
    assert future.result(0) == RESULT
    assert len(table.store.commits) == 1


def test_a_withdrawn_request_is_not_repeated(table, at_once):
    table.store.refusals = 1
    future = table.ask(TRAINING)
    table.jobs.withdraw("run_a")
    table.jobs.retries.run_due()
    assert (future.done(), len(table.jobs)) == (False, 0)


def test_a_checkpoint_is_stored_for_the_runs_that_wait(table):
    table.ask(TRAINING)
    checkpoint = Checkpoint(1, b"so far", ())
    for digest in (TRAINING.digest, "somebody else's"):
        table.jobs.note(digest, checkpoint)
    assert table.store.notes == [(TRAINING.digest, checkpoint, ["run_a"])]


def test_activities_show_running_stages_first_with_their_last_sign(table):
    for seed in (1, 2):
        table.ask(criticism(seed))
    table.ask(TRAINING, "run_b")
    job = table.start()
    table.jobs.hear(SignOfLife(job.stage.digest, 1, 0.5, {"steps": 7}, "actor_id", 1234))
    table.jobs.hear(SignOfLife("gone meanwhile", 1, 0.5, {}, "actor_id", 1234))
    first, second = table.jobs.activities("run_a")
    assert (first.state, first.fraction, first.pid) == ("running", 0.5, 1234)
    assert first.facts == {"steps": 7}
    assert (second.state, second.attempt, second.actor_id) == ("waiting", 0, None)
    assert len(table.jobs.activities()) == 3


class Unlisted(dict):
    """Jobs that can be looked up, and not gone through."""

    def values(self):
        raise AssertionError("all jobs are looked at")

    items = __iter__ = values


def test_asking_what_a_run_waits_for_looks_at_no_job_of_others(table):
    """A list of 100 running runs looked 100 times at all jobs, and so did a cancelled benchmark."""
    for seed in range(3):
        table.ask(criticism(seed), "run_b")
    table.ask(TRAINING, "run_a")
    table.jobs._jobs = Unlisted(table.jobs._jobs)
    assert [seen.kind for seen in table.jobs.activities("run_a")] == [TRAINING.kind]
    table.jobs.withdraw("run_a")
    assert table.jobs.activities("run_a") == []


def test_a_run_waits_for_nothing_once_its_stage_has_ended_or_it_has_withdrawn(table):
    for run_id in ("run_a", "run_a", "run_b"):
        table.ask(TRAINING, run_id)
    table.jobs.withdraw("run_b")
    assert (len(table.jobs.activities("run_a")), table.jobs.activities("run_b")) == (1, [])
    table.finish(table.start())
    assert table.jobs.activities("run_a") == table.jobs.activities() == []


def test_a_sign_that_a_lost_process_left_is_not_of_the_next_attempt(table):
    table.ask(TRAINING)
    job = table.start()
    late = SignOfLife(TRAINING.digest, job.attempt, 0.5, {}, "actor_id", 1)
    job.leave()
    table.jobs.lose(job, "killed")
    table.jobs.hear(late)
    assert job.sign is None
    table.start()
    table.jobs.hear(late)
    assert job.sign is None
    table.jobs.hear(own := replace(late, attempt=job.attempt))
    assert job.sign is own


def test_a_service_that_stops_ends_every_wait(table):
    futures = [table.ask(stage) for stage in (TRAINING, EPISODE)]
    table.jobs.fail_all(RunCancelled("the service is stopping"))
    for future in futures:
        with pytest.raises(RunCancelled):
            future.result(0)

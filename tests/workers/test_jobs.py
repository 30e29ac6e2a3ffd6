"""Jobs: who waits for one, whether it may have a core, and how people see it."""

from concurrent.futures import Future
from dataclasses import replace

import pytest

from adr_service.errors import StageFailed
from adr_service.stages.base import StageResult
from tests.db.rows import EXECUTION
from tests.stages.examples import criticism, episode, rollout, training
from workers.actors import Finished
from workers.heartbeats import SignOfLife
from workers.jobs import Job, Waiter, activity_of
from workers.pool import Actor, Core

SIGN = SignOfLife("digest", 1, 0.5, {"steps": 10}, "actor_id", 42)
ACTOR = Actor("adr:run_a:trainer:1", "trainer", None, Core("node"))
LATER = 1e9  # a monotonic time that never comes


@pytest.fixture
def job():
    """A training that `run_a` waits for."""
    return Job(training(), number=1, started_by="run_a", asked=0.0, waiters=[waiter("run_a")])


def waiter(run_id):
    return Waiter(run_id, Future())


def test_a_run_that_asked_twice_is_listed_once_and_in_order(job):
    job.waiters += [waiter("run_b"), waiter("run_a")]
    assert job.run_ids == ["run_a", "run_b"]


class TestWaiting:
    def test_a_new_job_waits_for_a_core(self, job):
        assert job.is_waiting

    @pytest.mark.parametrize("stage", [training(), criticism(), rollout()], ids=lambda s: s.kind)
    def test_every_stage_but_a_robots_waits_for_a_core(self, job, stage):
        job.stage = stage
        assert job.is_waiting
        job.stage = episode()
        assert not job.is_waiting

    def test_a_running_job_waits_no_more_until_its_actor_is_lost(self, job):
        job.place(ACTOR, object())
        assert not job.is_waiting
        job.leave()
        assert job.is_waiting

    def test_a_result_that_is_not_stored_yet_needs_no_core(self, job):
        job.finished = Finished(StageResult({}), EXECUTION)
        assert not job.is_waiting

    def test_a_job_without_runs_needs_no_core(self, job):
        job.waiters.clear()
        assert not job.is_waiting

    def test_a_job_is_not_due_before_the_database_is_tried_again(self, job):
        job.not_before = LATER
        assert not job.is_waiting


class TestLostNode:
    def test_a_node_that_may_have_died_is_avoided_for_a_while(self, job):
        job.lost_on, job.lost_at = "node", LATER
        assert job.avoid == "node"
        job.lost_at = -LATER
        assert job.avoid is None


def test_an_attempt_begins_alive_and_leaves_no_sign_behind(job):
    job.is_killed = True
    job.place(ACTOR, ref := object())
    assert (job.actor, job.ref, job.is_killed) == (ACTOR, ref, False)
    job.sign = SIGN
    job.since = -LATER
    job.leave()
    assert (job.actor, job.ref, job.sign) == (None, None, None)
    assert job.since > 0  # it waits anew


def test_a_failure_reaches_every_run_that_still_waits(job):
    job.waiters += [waiter("run_b"), waiter("run_c")]
    job.waiters[1].future.cancel()
    failure = StageFailed("train_policy", "worker_lost", "killed")
    job.fail(failure)
    first, cancelled, last = (each.future for each in job.waiters)
    assert first.exception(0) is last.exception(0) is failure
    assert cancelled.cancelled()


class TestActivity:
    def test_a_waiting_job_has_no_actor_and_no_progress(self, job):
        seen = activity_of(job, job.since + 3.0)
        assert seen.state == "waiting"
        assert seen.seconds == pytest.approx(3.0)
        assert (seen.fraction, seen.facts, seen.actor, seen.pid) == (0.0, {}, None, None)

    def test_a_running_job_shows_its_last_sign_of_life(self, job):
        job.attempt = 2
        job.place(ACTOR, object())
        job.sign = replace(SIGN, digest=job.stage.digest)
        seen = activity_of(job, job.since)
        assert (seen.state, seen.attempt, seen.fraction) == ("running", 2, 0.5)
        assert (seen.actor, seen.actor_id, seen.pid) == (ACTOR.name, "actor_id", 42)
        assert (seen.kind, seen.started_by) == ("train_policy", "run_a")

    def test_a_job_that_has_just_been_placed_has_no_sign_yet(self, job):
        job.place(ACTOR, object())
        seen = activity_of(job, job.since)
        assert (seen.state, seen.fraction, seen.actor_id) == ("running", 0.0, None)


def test_the_log_names_run_stage_kind_and_attempt(job):
    job.attempt = 1
    assert job.ids == {
        "run": "run_a",
        "stage": job.stage.digest,
        "kind": "train_policy",
        "attempt": 1,
    }

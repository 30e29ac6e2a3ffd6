"""Visits to targets under leases: whatever happens, each has one accepted result."""

import tempfile
import threading
import time
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    Bundle,
    RuleBasedStateMachine,
    initialize,
    invariant,
    multiple,
    rule,
)

from adr_service.events import FINISHED, RunStarted, RunStopped, RunSucceeded, state_after
from db import events, runs, visits
from db.clock import SteadyClock
from db.errors import NotFound, NotPossible
from db.models import OPEN_VISIT
from db.session import open_database
from db.visits import LeaseLost
from tests.db.leases import LEASE_S, SPEC, START, claim, complete, episode, publish
from tests.db.rows import stored
from tests.stages.examples import rollout


@pytest.fixture
def run_id(database):
    return runs.create_run(database, SPEC).id


class TestLeases:
    def test_a_task_is_one_claimants_at_a_time(self, database, run_id):
        id = publish(database, run_id)
        first = claim(database, "a")
        assert (first.id, first.state, first.worker, first.attempt) == (id, "claimed", "a", 1)
        assert claim(database, "b") is None
        assert claim(database, "b", START + timedelta(seconds=LEASE_S - 1)) is None

    def test_open_visits_are_found_among_those_that_are_done(self, database, run_id):
        publish(database, run_id)
        done = complete(database, claim(database))
        assert visits.list_visits(database, limit=1) == [done]
        later = publish(database, run_id, 1)
        [found] = visits.list_visits(database, states=OPEN_VISIT, limit=1)
        assert (found.id, found.state) == (later, "pending")

    def test_after_the_lease_another_may_have_it_and_the_first_is_refused(self, database, run_id):
        publish(database, run_id)
        first = claim(database, "a")
        second = claim(database, "b", START + timedelta(seconds=LEASE_S))
        assert (second.id, second.attempt) == (first.id, 2)
        for late in (
            lambda: complete(database, first),
            lambda: visits.heartbeat(database, first.id, first.lease, 3, START, LEASE_S),
            lambda: visits.release(database, first.id, first.lease),
            lambda: visits.fail(database, first.id, first.lease, "late"),
        ):
            with pytest.raises(LeaseLost, match="after 2 claims; stop"):
                late()
        assert stored(database, first.digest) is None
        assert complete(database, second).state == "done"

    def test_a_failed_task_stays_while_its_run_does(self, database, run_id):
        """A deletion of another run forgets nothing of this one, which may be resumed."""
        publish(database, run_id)
        task = claim(database)
        visits.fail(database, task.id, task.lease, "gripper broken")
        other = runs.create_run(database, SPEC).id
        events.append_event(database, other, RunSucceeded())
        runs.delete_run(database, other)
        assert (
            visits.fail(database, task.id, task.lease, "gripper broken").error == "gripper broken"
        )
        events.append_event(database, run_id, RunSucceeded())
        runs.delete_run(database, run_id)
        assert visits.list_visits(database) == []

    def test_a_heartbeat_makes_the_lease_longer(self, database, run_id):
        publish(database, run_id)
        task = claim(database)
        later = START + timedelta(seconds=50)
        beaten = visits.heartbeat(database, task.id, task.lease, 7, later, LEASE_S)
        assert beaten == visits.RenewedLease(later + timedelta(seconds=LEASE_S), is_wanted=True)
        assert visits.get_visit(database, task.id).steps == 7
        assert visits.release(database, task.id, task.lease).steps == 0  # nobody has begun it
        task = claim(database, now=later)
        assert claim(database, "b", START + timedelta(seconds=100)) is None

    def test_a_heartbeat_that_is_late_does_not_shorten_the_lease(self, database, run_id):
        publish(database, run_id)
        task = claim(database)
        later = START + timedelta(seconds=LEASE_S / 2)
        beaten = visits.heartbeat(database, task.id, task.lease, 7, later, LEASE_S)
        late = visits.heartbeat(database, task.id, task.lease, 7, START, LEASE_S)
        assert late.expires_at == beaten.expires_at

    @pytest.mark.parametrize("hours", [-1, 24 * 400])
    def test_leases_do_not_follow_a_wall_clock_that_is_set(self, database, run_id, hours):
        wall, steady = [START], [1000.0]
        clock = SteadyClock(lambda: wall[0], lambda: steady[0])
        publish(database, run_id)
        claim(database, "a", clock.now())
        wall[0] += timedelta(hours=hours)
        steady[0] += LEASE_S - 1
        assert claim(database, "b", clock.now()) is None, "a live robot lost its task"
        steady[0] += 1
        assert claim(database, "b", clock.now()), "a dead robot keeps its task"

    @pytest.mark.parametrize("hours", [-1, 24 * 400])
    def test_a_service_that_starts_gives_robots_one_lease_more(self, database, run_id, hours):
        """Whatever the wall clock was set to while there was no service."""
        publish(database, run_id)
        task = claim(database, "a")
        now = START + timedelta(hours=hours)
        visits.renew_leases(database, now, LEASE_S)
        assert claim(database, "b", now + timedelta(seconds=LEASE_S - 1)) is None
        assert claim(database, "b", now + timedelta(seconds=LEASE_S)).id == task.id

    def test_an_expired_lease_that_nobody_took_is_good(self, database, run_id):
        publish(database, run_id)
        task = claim(database)
        done = complete(database, task, now=START + timedelta(hours=1))
        assert done.state == "done"
        assert stored(database, task.digest).blobs == {"data": b"data"}
        assert done.steps == 10

    def test_the_same_upload_again_changes_nothing_and_another_is_refused(self, database, run_id):
        publish(database, run_id)
        task = claim(database)
        assert complete(database, task) == complete(database, task)
        with pytest.raises(LeaseLost, match="the task is done"):
            complete(database, task, content=b"other data")
        with pytest.raises(LeaseLost, match="the task is done"):
            complete(database, task, earned=2.0)

    def test_what_is_given_back_is_free_and_what_failed_is_not(self, database, run_id):
        publish(database, run_id)
        task = claim(database)
        visits.release(database, task.id, task.lease)
        again = claim(database)
        assert (again.id, again.attempt) == (task.id, 2)
        failed = visits.fail(database, again.id, again.lease, "the gripper is broken")
        assert (failed.state, failed.error) == ("failed", "the gripper is broken")
        assert visits.fail(database, again.id, again.lease, "said again") == failed
        assert claim(database) is None
        publish(database, run_id)  # its run was resumed
        assert claim(database).attempt == 3

    def test_a_robot_gets_tasks_of_its_kind_alone_in_order(self, database, run_id):
        first, second = publish(database, run_id, 0), publish(database, run_id, 1)
        assert claim(database, tasks=["hopper"]) is None
        assert claim(database, tasks=["hopper", "arm"]).id == first
        assert claim(database).id == second

    def test_a_run_that_is_to_stop_offers_nothing_and_tells_who_is_at_work(self, database, run_id):
        publish(database, run_id, 0)
        publish(database, run_id, 1)
        task = claim(database)
        runs.request_cancel(database, run_id)
        beaten = visits.heartbeat(database, task.id, task.lease, 1, START, LEASE_S)
        assert not beaten.is_wanted
        assert claim(database, "b") is None

    def test_a_visit_that_is_offered_again_after_its_run_failed_has_no_steps(
        self, database, run_id
    ):
        publish(database, run_id)
        task = claim(database)
        visits.heartbeat(database, task.id, task.lease, 7, START, LEASE_S)
        visits.fail(database, task.id, task.lease, "gripper broken")
        publish(database, run_id)
        again = visits.get_visit(database, task.id)
        assert (again.state, again.steps) == ("pending", 0)

    def test_the_end_of_a_run_withdraws_its_tasks(self, database, run_id):
        publish(database, run_id)
        task = claim(database)
        events.append_event(database, run_id, RunStopped(submission=1))
        assert visits.get_visit(database, task.id).state == "withdrawn"
        with pytest.raises(LeaseLost, match="the task is withdrawn"):
            complete(database, task)
        runs.delete_run(database, run_id)
        with pytest.raises(NotFound, match="no target task"):
            visits.get_visit(database, task.id)

    def test_the_policy_is_kept_for_the_robot_and_goes_with_its_run(self, database, run_id):
        id = publish(database, run_id)
        assert visits.policy_of(database, id) == b"weights"
        events.append_event(database, run_id, RunSucceeded())
        runs.delete_run(database, run_id)
        with pytest.raises(NotFound):
            visits.policy_of(database, id)


class TestSimulated:
    def test_the_simulated_target_completes_under_a_lease_like_a_robot(self, database, run_id):
        stage = rollout()
        with database.write("test") as session:
            first, second = (
                visits.claim_simulated(session, stage, run_id, name, START, LEASE_S)
                for name in ("lost", "next")
            )
        with database.write("test") as session, pytest.raises(LeaseLost):
            visits.finish(session, stage.digest, first)
        for _ in range(2):  # as when the answer to a commit was lost
            with database.write("test") as session:
                visits.finish(session, stage.digest, second)
        (task,) = visits.list_visits(database, external=False)
        assert (task.state, task.attempt, task.worker) == ("done", 2, "next")

    def test_no_robot_is_offered_it_and_a_claim_that_led_nowhere_is_forgotten(
        self, database, run_id
    ):
        stage = rollout()
        with database.write("test") as session:
            visits.claim_simulated(session, stage, run_id, "actor", START, LEASE_S)
        assert claim(database, now=START + timedelta(days=1)) is None
        visits.drop_simulated(database, stage.digest)
        assert visits.list_visits(database) == []


class TestStartOfAService:
    def test_what_no_robot_has_claimed_waits_until_a_run_asks_for_it_again(self, database, run_id):
        """After an upgrade it may ask for another policy's episode: the old one's came first."""
        taken, left = (publish(database, run_id, number) for number in range(2))
        lease = claim(database).lease
        visits.forget_unclaimed(database)
        assert visits.get_visit(database, taken).lease == lease
        assert visits.get_visit(database, left).state == "withdrawn"
        assert claim(database) is None
        for number in range(2):
            publish(database, run_id, number)
        assert claim(database).id == left
        assert visits.get_visit(database, taken).lease == lease


class Machine(RuleBasedStateMachine):
    """Runs, their visits and robots that come, go, hang and are late; the service crashes.

    Few rules with many outcomes: Hypothesis leaves whole rules out of its stories.
    """

    leases = Bundle("leases")  # (task as claimed), good or not

    def __init__(self):
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.url = f"sqlite:///{Path(self.folder.name) / 'adr.sqlite'}"
        self.database = open_database(self.url)
        self.now = START
        self.runs = {}  # id: number of visits
        self.current = {}  # task id: the lease that counts
        self.accepted = {}  # task id: (lease, content)
        self.failed = {}  # task id: lease

    def teardown(self):
        self.database.close()
        self.folder.cleanup()

    @initialize()
    def submit(self):
        run_id = runs.create_run(self.database, SPEC).id
        events.append_event(self.database, run_id, RunStarted(submission=1))
        self.runs[run_id] = 1 + len(self.runs) % 2
        for number in range(self.runs[run_id]):
            publish(self.database, run_id, number)

    @rule(target=leases, worker=st.sampled_from(["a", "b"]), after=st.sampled_from([0, 59, 61]))
    def claim(self, worker, after):
        """Now, just before what somebody else has expires, or just after it."""
        self.now += timedelta(seconds=after)
        task = claim(self.database, worker, self.now)
        if task is None:
            return multiple()
        assert task.id not in self.accepted
        self.current[task.id] = task.lease
        return task

    @rule(task=leases, word=st.sampled_from(["heartbeat", "x", "y", "release", "fail"]))
    def speak(self, task, word):
        """In time, late, again, or with something else than before."""
        is_good = self.current.get(task.id) == task.lease
        if word == "fail":
            is_good = is_good or self.failed.get(task.id) == task.lease
        try:
            if word == "heartbeat":
                visits.heartbeat(self.database, task.id, task.lease, 1, self.now, LEASE_S)
            elif word == "release":
                visits.release(self.database, task.id, task.lease)
            elif word == "fail":
                visits.fail(self.database, task.id, task.lease, "broken")
                self.failed[task.id] = task.lease
            else:
                complete(self.database, task, content=word.encode(), now=self.now)
        except LeaseLost:
            assert not is_good
            assert self.accepted.get(task.id) != (task.lease, word.encode())
            return
        if word in ("x", "y"):
            assert is_good or self.accepted.get(task.id) == (task.lease, word.encode())
            self.accepted.setdefault(task.id, (task.lease, word.encode()))
        else:
            assert is_good
        if word != "heartbeat":
            self.current.pop(task.id, None)

    @rule(data=st.data(), what=st.sampled_from(["submit", "cancel", "end", "resume", "crash"]))
    def happen(self, data, what):
        if what == "crash":  # what is not on disk is gone
            self.database.close()
            self.database = open_database(self.url)
        elif what == "submit":
            self.submit()
        else:
            run_id = data.draw(st.sampled_from(list(self.runs)))
            {"cancel": self.cancel, "end": self.end, "resume": self.resume}[what](run_id)

    def cancel(self, run_id):
        with suppress(NotPossible):
            runs.request_cancel(self.database, run_id)

    def end(self, run_id):
        """The run's thread sees that it was cancelled, or finds all its visits."""
        if self.state(run_id) in FINISHED:
            return
        record = runs.get_run(self.database, run_id)
        own = visits.list_visits(self.database, run_id=run_id)
        if record.cancel_requested:
            events.append_event(self.database, run_id, RunStopped(submission=record.submission))
        elif all(task.state == "done" for task in own):
            events.append_event(self.database, run_id, RunSucceeded())
        for task in own:
            if self.state(run_id) in FINISHED:
                self.current.pop(task.id, None)

    def resume(self, run_id):
        try:
            record = runs.resubmit(self.database, run_id)
        except NotPossible:
            return
        events.append_event(self.database, run_id, RunStarted(submission=record.submission))
        for number in range(self.runs[run_id]):
            if stored(self.database, episode(run_id, number).digest) is None:
                self.failed.pop(publish(self.database, run_id, number), None)

    @invariant()
    def one_result_of_each_task_and_it_is_the_accepted_one(self):
        for run_id, number in self.runs.items():
            for task in visits.list_visits(self.database, run_id=run_id):
                result = stored(self.database, task.digest)
                assert (task.state == "done") == (result is not None) == (task.id in self.accepted)
                if result is not None:
                    assert result.blobs["data"] == self.accepted[task.id][1]
                if task.state == "claimed":
                    assert task.lease == self.current[task.id]
            assert len(visits.list_visits(self.database, run_id=run_id)) == number

    @invariant()
    def a_run_is_what_its_events_say_and_nothing_open_is_left_of_one_that_ended(self):
        for run_id in self.runs:
            written = [e.event for e in events.events_of(self.database, run_id)]
            state = self.state(run_id)
            assert state == state_after(written)
            if state in FINISHED:
                open_tasks = visits.list_visits(self.database, run_id=run_id)
                assert not [t for t in open_tasks if t.state in ("pending", "claimed")]

    def state(self, run_id):
        return runs.get_run(self.database, run_id).state


TestMachine = Machine.TestCase
TestMachine.settings = settings(
    max_examples=6,
    stateful_step_count=30,
    deadline=None,
    derandomize=True,
    phases=[Phase.generate],  # to shrink a story takes minutes
    suppress_health_check=list(HealthCheck),
)


@pytest.mark.slow
class TestManyStories(TestMachine):
    settings = settings(TestMachine.settings, max_examples=60)


def test_of_eight_claimers_that_sleep_over_their_leases_one_is_accepted_for_each_task(
    database, run_id
):
    ids = [publish(database, run_id, number) for number in range(40)]
    accepted, late, wrong = [], [], []

    def work(seed):
        rng = np.random.default_rng(seed)
        while len(accepted) < len(ids):
            task = visits.claim(database, f"robot-{seed}", ["arm"], datetime.now(UTC), 0.02)
            if task is None:
                time.sleep(0.002)
                continue
            time.sleep(rng.choice([0.0, 0.01, 0.05]))  # the lease is 0.02 s
            content = f"{task.id} {task.attempt}".encode()
            try:
                complete(database, task, content=content, now=datetime.now(UTC))
            except LeaseLost:
                late.append(task.id)
            except Exception as error:  # noqa: BLE001 - the test says which
                wrong.append(error)
            else:
                accepted.append((task.id, content))

    claimers = [threading.Thread(target=work, args=(seed,)) for seed in range(8)]
    for claimer in claimers:
        claimer.start()
    for claimer in claimers:
        claimer.join(60)
    assert not wrong
    assert late, "nobody was late: the test has shown nothing"
    assert sorted(id for id, _ in accepted) == sorted(ids)
    for id, content in accepted:
        digest = visits.get_visit(database, id).digest
        assert stored(database, digest).blobs == {"data": content}

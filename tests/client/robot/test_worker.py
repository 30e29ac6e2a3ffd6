"""The loop of a robot's client, with a service whose answers the test gives."""

import re
import signal
import threading
from pathlib import Path

import pytest

from adr_service.client.http import Refused, Unreachable
from adr_service.client.robot import worker
from adr_service.client.robot.environment import RobotFailed
from adr_service.client.robot.limits import Limits
from adr_service.client.robot.playback import about
from adr_service.client.robot.unsent_episodes import UnsentEpisode
from adr_service.client.robot.worker import Robot
from adr_service.errors import InvalidInput, UnknownName
from adr_service.stages.target_episode import read_episode
from adr_service.tasks.catalogue import get_task
from tests.client.robot.test_episode import ABOUT
from tests.robots import BreakingArm

TASK = {
    "id": "task_a",
    "kind": "rollout",
    "number": 1,
    "seed": 2,
    "transitions": 20,
    "has_policy": False,
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The working directory, where episodes are kept until the service has them."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


ASIDE = {"task_a.lease_a.npz", "task_a.lease_a.lease_kept"}


class Service:
    """Hands out one task again and again, and keeps what becomes of it."""

    url = "http://bench"

    def __init__(self, refusal=None, **changes):
        self.task, self.refusal = {**TASK, **changes}, refusal
        self.uploads, self.failures, self.released = [], [], []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def tasks(self):
        return [ABOUT]

    def claim_task(self, worker, tasks, wait_s):
        return {"task": self.task, "lease": "lease_a", "lease_s": 60.0}

    def heartbeat(self, task_id, lease, steps):
        return {"cancel_requested": False}

    def complete_task(self, task_id, lease, content):
        if self.refusal is not None:
            raise self.refusal
        self.uploads.append(content)

    def fail_task(self, task_id, lease, message):
        self.failures.append(message)

    def release_task(self, task_id, lease):
        self.released.append(task_id)


def robot(
    service, environment="fast_arm", task="arm", limits=None, reports=None, abandon=pytest.fail
):
    report = (reports if reports is not None else []).append
    path = f"tests.robots:{environment}"
    return Robot(lambda _: service, task, path, "bench", limits or Limits(), report, abandon)


def test_it_runs_as_many_episodes_as_asked_and_the_service_can_read_them():
    service, reports = Service(), []
    robot(service, reports=reports).work(2)
    assert len(service.uploads) == 2
    assert read_episode("arm", 20, service.uploads[0]).transitions == 20
    assert "rollout, 20 steps" in reports[-1]


def test_an_unknown_task_is_refused_with_the_known_ones():
    with pytest.raises(UnknownName, match="accepted: arm"):
        robot(Service(), task="amr")


def test_a_task_that_has_changed_meanwhile_moves_nothing():
    """Its owner has narrowed its actions; the client of before would have drawn wider ones."""
    service = Service()
    worker = robot(service)
    service.tasks = lambda: [{**ABOUT, "action_high": [0.5, 0.5]}]
    with pytest.raises(InvalidInput, match=r"arm has changed .* in action_high: start the client"):
        worker.work(1)
    assert (service.released, service.uploads) == (["task_a"], [])
    assert not worker._env.actions


def test_a_task_goes_back_where_its_owner_stops_the_client_before_it_is_looked_at():
    service = Service()
    worker = robot(service)

    def claim(worker_name, tasks, wait_s):
        worker.stop()
        return {"task": service.task, "lease": "lease_a", "lease_s": 60.0}

    service.claim_task = claim
    worker.work(1)
    assert service.released == ["task_a"]


def test_an_episode_longer_than_the_robot_may_move_goes_back():
    service = Service(kind="return")
    with pytest.raises(InvalidInput, match=r"asks for 0\.4 s, and this robot may move for 0\.1"):
        robot(service, limits=Limits(seconds=0.1)).work(1)
    assert service.released == ["task_a"]


def test_an_episode_of_steps_that_take_too_long_goes_back():
    """It may move for longer than the steps should take, but not for as long as they do."""
    service = Service(kind="return")
    with pytest.raises(InvalidInput, match=r"--max-seconds.* of 20 steps; their return counts"):
        robot(service, "slowest_arm", limits=Limits(seconds=0.45)).work(1)
    assert (service.released, service.failures) == (["task_a"], [])


@pytest.mark.parametrize("kind", ["rollout", "return", "evaluation"])
@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ("narrow_arm", r"shape \(3,\); arm has \(4,\): .* after 0 of 20 steps; see to the robot"),
        ("blind_arm", r"the robot showed \[nan.* steps; see to the robot"),
    ],
)
def test_a_robot_whose_sensors_fail_does_nothing_more(environment, message, kind):
    """Its tasks would fail one after the other, or be learnt from for as long as they went well."""
    service = Service(kind=kind)
    worker = robot(service, environment)
    with pytest.raises(RobotFailed, match=message):
        worker.work()
    assert (service.released, service.uploads, service.failures) == (["task_a"], [], [])


def test_a_rollout_that_the_owner_cuts_is_uploaded():
    rollout = Service()
    robot(rollout, "slowest_arm", limits=Limits(seconds=0.45)).work(1)
    assert 0 < read_episode("arm", 20, rollout.uploads[0]).transitions < 20


def test_a_rollout_that_the_owner_cuts_before_its_first_step_goes_back():
    """Its run is somebody else's, and would fail."""
    service = Service()
    with pytest.raises(InvalidInput, match="after 0 of 20 steps; there is nothing to learn from"):
        robot(service, limits=Limits(seconds=0.01)).work(1)
    assert (service.released, service.uploads, service.failures) == (["task_a"], [], [])


def test_a_rollout_that_the_owner_cuts_too_short_for_its_method_goes_back(folder):
    service = Service(refusal=Refused(422, "learns from no fewer in a row"))
    with pytest.raises(InvalidInput, match=r"--max-seconds.* steps; learns from no fewer in a row"):
        robot(service, "slowest_arm", limits=Limits(seconds=0.45)).work(1)
    assert (service.released, service.failures) == (["task_a"], [])
    assert {path.name for path in folder.iterdir()} == ASIDE


@pytest.mark.parametrize("kind", ["return", "evaluation"])
def test_an_episode_that_the_environment_cuts_short_has_no_return(kind):
    service = Service(kind=kind)
    with pytest.raises(InvalidInput, match=r"ended the episode early .truncated. after 5 of 20 st"):
        robot(service, "cut_arm").work(1)
    assert (service.released, service.uploads, service.failures) == (["task_a"], [], [])


def test_an_episode_that_is_truncated_at_its_end_is_whole():
    service = Service(kind="return", transitions=5)
    robot(service, "cut_arm").work(1)
    assert read_episode("arm", 5, service.uploads[0]).transitions == 5


@pytest.mark.parametrize("status", [401, 403, 413, 500])
def test_an_episode_that_the_service_does_not_take_is_sent_by_the_next_client(status, folder):
    service, reports = Service(refusal=Refused(status, "a defect")), []
    with pytest.raises(Refused, match="a defect"):
        robot(service, reports=reports).work(1)
    assert (service.released, service.failures) == ([], [])
    assert str(folder / "task_a.npz") in reports[-1]
    assert (folder / "task_a.lease").stat().st_mode & 0o777 == 0o600
    mended, reports = Service(), []
    stopping(robot(mended, reports=reports), mended).work()
    assert read_episode("arm", 20, mended.uploads[0]).transitions == 20
    assert "task_a, left by an earlier client: the service has its episode now" in reports
    assert not list(folder.iterdir())


@pytest.mark.parametrize("status", [401, 403, 413, 500])
def test_the_robot_does_nothing_while_an_earlier_episode_is_refused(status, folder):
    """It would get the same task, and overwrite the episode."""
    service = Service(refusal=Refused(status, "a defect"))
    with pytest.raises(Refused, match="a defect"):
        robot(service).work(1)
    content = (folder / "task_a.npz").read_bytes()
    service.claim_task = None
    with pytest.raises(Refused, match="a defect"):
        robot(service).work(1)
    assert (folder / "task_a.npz").read_bytes() == content
    assert (folder / "task_a.lease").exists()


def test_an_episode_of_a_deleted_task_is_set_aside(folder):
    with pytest.raises(Refused):
        robot(Service(refusal=Refused(500, "a defect"))).work(1)
    service, reports = Service(refusal=Refused(404, "no such task")), []
    stopping(robot(service, reports=reports), service).work()
    refused = "task_a, left by an earlier client: http://bench did not accept it, no such task"
    assert refused in reports
    assert {file.name for file in folder.iterdir()} == ASIDE


def stopping(worker, service):
    """A robot that claims nothing."""
    service.claim_task = lambda *_: worker.stop()
    return worker


@pytest.mark.parametrize(("status", "fails"), [(409, False), (422, True), (404, False)])
def test_an_episode_that_is_refused_for_good_is_not_sent_again(status, fails, folder):
    service, reports = Service(refusal=Refused(status, "no good")), []
    worker = robot(service, reports=reports)
    claims = iter([service.claim_task("bench", ["arm"], 0)])
    service.claim_task = lambda *_: next(claims, None) or worker.stop()
    worker.work()
    assert service.failures == (["the service refused the episode: no good"] if fails else [])
    assert {file.name for file in folder.iterdir()} == ASIDE
    assert str(folder / "task_a.lease_a.npz") in " ".join(reports)
    assert any("did not accept it, no good" in each for each in reports)


class Away(Service):
    """Is gone when the episode ends, and the owner stops the robot then."""

    def complete_task(self, task_id, lease, content):
        self.robot.stop()
        raise Unreachable("gone")


def test_an_episode_that_the_owner_does_not_wait_to_upload_is_kept(tmp_path):
    service = Away()
    service.robot = robot(service)
    service.robot.work(1)
    assert read_episode("arm", 20, (tmp_path / "task_a.npz").read_bytes()).transitions == 20


def test_an_episode_that_has_ended_is_kept_though_its_robot_should_stop(folder):
    service = Service()
    stopping = robot(service)
    step = stopping._env.step

    def last_step(action):
        if len(stopping._env.actions) == TASK["transitions"] - 1:
            stopping.stop()
        return step(action)

    stopping._env.step = last_step
    stopping.work(1)
    assert service.released == []
    assert read_episode("arm", 20, (folder / "task_a.npz").read_bytes()).transitions == 20
    robot(service).work(0)
    assert len(service.uploads) == 1


@pytest.mark.parametrize("number", [1, 2])
def test_an_interrupt_while_an_episode_is_written_loses_nothing(number, folder, monkeypatch):
    service, written = Service(), []

    def write(path, content):
        path.write_bytes(content)
        written.append(path.name)
        if len(written) == number:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("adr_service.client.robot.unsent_episodes._write", write)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run without
    try:
        with pytest.raises(KeyboardInterrupt):
            robot(service).work(1)
    finally:
        signal.signal(signal.SIGINT, before)
    assert written == ["task_a.lease", "task_a.npz"]
    robot(service).work(0)
    assert len(service.uploads) == 1


def test_a_lease_without_its_episode_is_ignored(folder):
    """As a power cut leaves it, between the two files."""
    (folder / "task_a.lease").write_text("lease_a")
    service = Service()
    robot(service).work(1)
    assert len(service.uploads) == 1


def test_a_service_that_answers_leaves_no_file(tmp_path):
    robot(Service()).work(1)
    assert not list(tmp_path.iterdir())


def test_a_stopped_robot_claims_nothing():
    service = Service()
    stopped = robot(service)
    stopped.stop()
    stopped.work(1)
    assert service.uploads == []


class Breaking(Service):
    """Notes whether the robot was closed when its task came back."""

    def release_task(self, task_id, lease):
        super().release_task((task_id, self.robot._env.closed), lease)


def test_a_robot_that_breaks_is_closed_before_the_service_is_told():
    service = Breaking()
    service.robot = robot(service, "breaking_arm")
    with pytest.raises(RuntimeError, match="the bus is gone"):
        service.robot.work(1)
    assert service.released == [("task_a", 1)]
    assert service.robot._env.closed == 1


def test_a_drivers_error_of_the_system_is_named_as_the_robots():
    """A broken pipe of its own looked like a closed output, and ended the client without a word."""
    service = Service()
    worker = robot(service)
    worker._env.step = worker._env.close = raising(BrokenPipeError(32, "Broken pipe"))
    with pytest.raises(RobotFailed, match=r"failed, BrokenPipeError: .*; see to the robot"):
        worker.work(1)
    assert len(service.released) == 1


def test_a_robot_is_closed_where_nobody_can_be_told_that_it_waits():
    def report(line):
        raise OSError(28, "No space left on device")

    waiting = robot(Service(), "breaking_arm")
    waiting._report = report
    with pytest.raises(OSError, match="No space left"):
        waiting.work(1)
    assert BreakingArm.last.closed == 1


def test_a_robot_works_once_because_its_end_closes_the_environment():
    service = Service()
    closed = robot(service, "breaking_arm")
    closed.stop()
    closed.work(1)
    with pytest.raises(InvalidInput, match="this robot is closed; make another Robot"):
        closed.work(1)
    assert BreakingArm.last.closed == 1


def test_a_robot_that_hangs_while_it_is_closed_is_abandoned():
    abandoned, reports = threading.Event(), []
    limits = Limits(reset_seconds=0.1)
    worker = robot(Service(), limits=limits, reports=reports, abandon=abandoned.set)
    worker._env.close = lambda: abandoned.wait(60)
    worker.stop()
    worker.work(1)
    assert abandoned.is_set()
    assert reports[-1] == "the environment's close did not return within 0.1 s; see to the robot"


def test_a_robot_that_does_not_fit_is_closed():
    with pytest.raises(InvalidInput, match="limits of actions must be positive"):
        robot(Service(), "breaking_arm", limits=Limits(actions=(-1.0,)))
    assert BreakingArm.last.closed == 1


def test_steps_that_take_longer_than_they_count_are_remarked():
    """Its steps sleep for longer than the tenth of a period more that is let pass."""
    service, reports = Service(), []
    robot(service, "sleepy_arm", reports=reports).work(1)
    assert re.search(
        r"; a step took [\d.]+ s on average, and counts as 0.02 s: methods", reports[-1]
    )


def test_an_episode_is_sent_though_no_file_can_be_written(folder, monkeypatch):
    service, reports = Service(), []
    monkeypatch.setattr(Path, "replace", raising(OSError("the disk is full")))
    robot(service, reports=reports).work(1)
    assert len(service.uploads) == 1
    refusing = Service(refusal=Refused(500, "a defect"))
    with pytest.raises(Refused):
        robot(refusing, reports=reports).work(1)
    assert "it is in no file, because none could be written" in reports[-1]
    assert "task_a: no file can be written here, in case it cannot be sent" in reports
    assert not list(folder.iterdir())


def raising(error):
    def raises(*_):
        raise error

    return raises


def test_a_robot_that_cannot_be_closed_gives_its_task_back_all_the_same():
    service = Breaking()
    service.robot = robot(service, "breaking_arm")
    service.robot._env.close = raising(OSError("the bus is gone as well"))
    with pytest.raises(RobotFailed, match=r"close failed, OSError: .* as well; see to the robot"):
        service.robot.work(1)
    assert len(service.released) == 1


class Busy(Service):
    """Refuses the first two uploads for a moment."""

    def complete_task(self, task_id, lease, content):
        self.asked = getattr(self, "asked", 0) + 1
        if self.asked < 3:
            raise Refused(507, "the disk is full", 0.01)
        super().complete_task(task_id, lease, content)


def test_a_service_that_asks_to_wait_is_reported_once():
    service, reports = Busy(), []
    robot(service, reports=reports).work(1)
    assert len([each for each in reports if each.startswith("the disk is full")]) == 1
    assert len(service.uploads) == 1


def test_an_idle_robot_waits_while_the_service_has_a_defect(monkeypatch):
    monkeypatch.setattr(worker, "_RETRY_S", 0.01)
    service, reports = Service(), []
    answers = iter([Refused(500, "a defect"), Refused(500, "a defect")])
    claim = service.claim_task

    def claimed(*asked):
        if (error := next(answers, None)) is not None:
            raise error
        return claim(*asked)

    service.claim_task = claimed
    robot(service, reports=reports).work(1)
    assert len([each for each in reports if each.startswith("a defect; trying again")]) == 1
    assert len(service.uploads) == 1
    service.claim_task = raising(Refused(403, "another token"))
    with pytest.raises(Refused, match="another token"):
        robot(service).work(1)


def test_an_episode_whose_file_cannot_be_deleted_is_reported_and_sent_again(folder, monkeypatch):
    """As on a card that can only be read after an error."""
    service, reports = Service(), []
    with monkeypatch.context() as only_read:
        only_read.setattr(UnsentEpisode, "discard", raising(OSError("Read-only file system")))
        robot(service, reports=reports).work(1)
    left = "task_a: the service has the episode, but its file cannot be deleted: Read-only"
    assert any(each.startswith(left) for each in reports)
    assert len(service.uploads) == 1
    stopping(robot(service), service).work()
    assert len(service.uploads) == 2
    assert not list(folder.iterdir())


def test_an_episode_of_another_user_is_named(folder):
    (folder / "task_a.lease").mkdir()  # which cannot be read as a file
    with pytest.raises(
        InvalidInput, match=r"task_a\.npz and task_a\.lease, .* cannot be read: Is a"
    ):
        robot(Service()).work(1)


def test_a_client_compares_all_facts_of_its_task():
    assert {"name", *worker._FACTS} == about(get_task("arm")).keys()

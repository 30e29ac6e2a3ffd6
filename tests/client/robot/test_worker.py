"""The loop of a robot's client, with a service whose answers the test gives."""

import pytest

from adr_service.client.connection import Refused, Unreachable
from adr_service.client.robot.limits import Limits
from adr_service.client.robot.worker import Robot
from adr_service.errors import InvalidInput, UnknownName
from adr_service.stages.target_episode import read_episode
from tests.client.robot.test_episode import ABOUT

TASK = {
    "id": "task_a",
    "kind": "rollout",
    "number": 1,
    "seed": 2,
    "transitions": 20,
    "has_policy": False,
}


class Service:
    """Hands out one task again and again, and keeps what becomes of it."""

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


def robot(service, environment="fast_arm", task="arm", limits=None, reports=None):
    report = (reports if reports is not None else []).append
    path = f"tests.robots:{environment}"
    return Robot(lambda _: service, task, path, "bench", limits or Limits(), report, pytest.fail)


def test_it_runs_as_many_episodes_as_asked_and_the_service_can_read_them():
    service, reports = Service(), []
    robot(service, reports=reports).work(2)
    assert len(service.uploads) == 2
    assert read_episode("arm", 20, service.uploads[0]).transitions == 20
    assert "rollout, 20 steps" in reports[-1]


def test_an_unknown_task_is_refused_with_the_known_ones():
    with pytest.raises(UnknownName, match="accepted: arm"):
        robot(Service(), task="amr")


def test_an_episode_longer_than_the_robot_may_move_goes_back():
    service = Service(kind="return")
    with pytest.raises(InvalidInput, match=r"asks for 0\.4 s, and this robot may move for 0\.1"):
        robot(service, limits=Limits(seconds=0.1)).work(1)
    assert service.released == ["task_a"]


def test_an_episode_of_steps_that_take_too_long_goes_back():
    """It may move for longer than the steps should take, but not for as long as they do."""
    service = Service(kind="return")
    with pytest.raises(InvalidInput, match="of 20 steps, whose return counts: allow more --max-se"):
        robot(service, "slowest_arm", limits=Limits(seconds=0.45)).work(1)
    assert (service.released, service.failures) == (["task_a"], [])


def test_a_cut_rollout_is_uploaded():
    rollout = Service()
    robot(rollout, "blind_arm").work(1)
    assert 0 < read_episode("arm", 20, rollout.uploads[0]).transitions < 20


def test_a_service_that_is_to_blame_gets_its_task_back(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    service, reports = Service(refusal=Refused(500, "a defect")), []
    with pytest.raises(Refused, match="a defect"):
        robot(service, reports=reports).work(1)
    assert service.released == ["task_a"]
    assert str(tmp_path / "task_a.npz") in reports[-1]
    assert read_episode("arm", 20, (tmp_path / "task_a.npz").read_bytes()).transitions == 20


class Away(Service):
    """Is gone when the episode ends, and the owner stops the robot then."""

    def complete_task(self, task_id, lease, content):
        self.robot.stop()
        raise Unreachable("http://127.0.0.1:8000", "gone")


def test_an_episode_that_the_owner_does_not_wait_to_upload_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    service = Away()
    service.robot = robot(service)
    service.robot.work(1)
    assert read_episode("arm", 20, (tmp_path / "task_a.npz").read_bytes()).transitions == 20


def test_a_service_that_answers_leaves_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot(Service()).work(1)
    assert not list(tmp_path.iterdir())


def test_a_stopped_robot_claims_nothing():
    service = Service()
    stopped = robot(service)
    stopped.stop()
    stopped.work(1)
    assert service.uploads == []

"""A robot in the loop: another process that the service knows by its leases alone."""

import json
import os
import re
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from adr_service.client import AdrClient, Refused
from adr_service.client.robot import Limits, Robot, RobotFailed
from adr_service.errors import InvalidInput
from adr_service.transitions import TransitionDataset
from tests.service import start_service, until, wait_until_finished

pytestmark = pytest.mark.ray
LEASE_S = 2.0
RUN = {
    "task": "arm",
    "method": "simopt",
    "preset": "smoke",
    "seed": 1,  # none of its policies spins the arm, which would end an episode early
    "iterations": 2,
    "transitions": 60,
    "evaluation_episodes": 2,
    "training": {"max_steps": 900},
    "target": {"kind": "external"},
}
NO_LIMITS = Limits()
EPISODES_BEFORE_FIT = 3  # of an offline method: two evaluations of the prior, one rollout
EPISODES = 8  # two rollouts, and two evaluations after each of 0, 1 and 2


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robots")
    leases = {"ADR_LEASE_S": str(LEASE_S)}
    with start_service(folder, cpus=2, environment=leases) as running:
        yield running


@contextmanager
def robot_process(url, factory, log, *options):
    """`adr robot` as its owner starts it; ended by pid."""
    command = [sys.executable, "-m", "api", "robot", "--task", "arm", "--url", url]
    command += ["--env", f"tests.robots:{factory}", *options]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
        try:
            yield process
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(timeout=30)


def in_this_process(client, env, limits=NO_LIMITS, task="arm"):
    """A robot whose environment the test can look at, and what it reports."""
    told = []
    connect = partial(AdrClient, client.url, "")
    return Robot(connect, task, env, "here", limits, told.append), told


@contextmanager
def at_work(robot):
    thread = threading.Thread(target=robot.work, daemon=True)
    thread.start()
    try:
        yield
    finally:
        robot.stop()
        thread.join(30)


def tasks_of(client, run_id, **filters):
    return client.list_all("target_tasks", run_id=run_id, external="true", **filters)


@pytest.mark.slow
def test_a_robot_that_dies_in_an_episode_costs_that_episode_alone(service, tmp_path):
    client = service.client
    run_id = client.submit_run(RUN)["id"]
    with robot_process(client.url, "slow_arm", tmp_path / "a", "--name", "a") as robot:
        # it has moved, and then nobody hears of it again
        claimed = until(
            lambda: [t for t in tasks_of(client, run_id, state="claimed") if t["steps"] > 5]
        )
        robot.kill()
        robot.wait(timeout=30)
    with robot_process(client.url, "fast_arm", tmp_path / "b", "--name", "b"):
        assert wait_until_finished(client, run_id, 120)["state"] == "succeeded"
    tasks = tasks_of(client, run_id)
    assert [task["state"] for task in tasks] == ["done"] * EPISODES
    (again,) = [task for task in tasks if task["id"] == claimed[0]["id"]]
    assert (again["worker"], again["attempt"]) == ("b", 2)
    events = [e["event"] for e in client.get_events(run_id)]
    visits = [e["digest"] for e in events if e.get("kind") == "target_episode"]
    assert len(visits) == len(set(visits)) == EPISODES
    rows = client.results(run_id)["rows"]
    assert [row["target_transitions"] for row in rows] == [0, 60, 120]
    assert [row["episodes"] for row in rows] == [2, 2, 2]
    assert rows[0]["estimation_error"] is None  # nobody knows a robot's truth
    assert "return" in (tmp_path / "b").read_text()


def test_a_client_that_has_gone_while_it_waited_gets_no_task(service):
    client = service.client
    host, port = client.url.removeprefix("http://").split(":")
    body = json.dumps({"worker": "gone", "tasks": ["arm"], "wait_s": 20}).encode()
    head = f"POST /v1/target_tasks/claim HTTP/1.1\r\nHost: {host}\r\n"
    head += f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n"
    with socket.create_connection((host, int(port))) as waiting:
        waiting.sendall(head.encode() + body)
        time.sleep(1)  # it waits there; nothing shows it
    run_id = client.submit_run({**RUN, "seed": 77})["id"]
    until(lambda: tasks_of(client, run_id))
    time.sleep(1)  # for whoever still waits
    assert {(t["state"], t["attempt"]) for t in tasks_of(client, run_id)} == {("pending", 0)}
    client.cancel(run_id)


@pytest.mark.slow
def test_the_docs_commands_run_an_external_target_to_its_end(service, tmp_path):
    page = (Path(__file__).parents[2] / "docs/robots.md").read_text()
    (module,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    commands = re.findall(r"```bash\n(.*?)```", page, re.DOTALL)
    (tmp_path / "my_robot.py").write_text(module)
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-e", "-c", commands[0]],
        cwd=tmp_path,
        env={**os.environ, "ADR_URL": service.client.url, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"simopt +1 ", done.stdout)  # its row after one trajectory


def test_a_simulated_target_goes_through_the_same_tasks(service):
    client = service.client
    spec = {**RUN, "target": {"kind": "simulated"}, "seed": 3}
    run_id = client.submit_run(spec)["id"]
    assert wait_until_finished(client, run_id, 120)["state"] == "succeeded"
    tasks = client.list_all("target_tasks", run_id=run_id)
    assert {(t["external"], t["state"], t["attempt"]) for t in tasks} == {(False, "done", 1)}
    assert [t["kind"] for t in tasks].count("target_rollout") == RUN["iterations"]


def test_a_robot_stops_within_a_control_step_of_hearing_that_its_run_is_cancelled(service):
    client = service.client
    run_id = client.submit_run({**RUN, "seed": 1})["id"]
    robot, told = in_this_process(client, "tests.robots:slow_arm")
    with at_work(robot):
        until(lambda: [t for t in tasks_of(client, run_id, state="claimed") if t["steps"] > 5])
        client.cancel(run_id)
        until(lambda: any("stopped" in line for line in told), 5)
        last = robot._env.step_times[-1]
        time.sleep(0.2)
        assert robot._env.step_times[-1] == last, "it moves on"
    assert "asked to stop" in told[-1] or "withdrawn" in told[-1]
    assert wait_until_finished(client, run_id, 60)["state"] == "cancelled"
    assert {t["state"] for t in tasks_of(client, run_id)} == {"withdrawn"}


@pytest.mark.parametrize(
    ("factory", "options", "is_cancelled", "message"),
    [
        pytest.param(
            *("stuck_arm", ["--max-seconds", "6"], False, "step did not return within"),
            marks=pytest.mark.slow,
        ),
        ("stuck_reset", ["--max-reset-seconds", "2"], False, "reset did not return within 2.0 s"),
        pytest.param(
            *("stuck_arm", [], True, "and the environment's step does not return"),
            marks=pytest.mark.slow,  # it waits for the last of several limits
        ),
    ],
)
def test_a_robot_whose_environment_hangs_gives_its_task_back_and_ends(
    service, tmp_path, factory, options, is_cancelled, message
):
    """It kept its lease for ever, and went on after its run was cancelled."""
    client = service.client
    run_id = client.submit_run({**RUN, "seed": 40 + len(options) + is_cancelled})["id"]
    with robot_process(client.url, factory, tmp_path / "log", *options) as robot:
        until(lambda: tasks_of(client, run_id, state="claimed"))
        if is_cancelled:
            until(lambda: [t for t in tasks_of(client, run_id) if t["steps"] > 5])
            client.cancel(run_id)
        assert robot.wait(timeout=60) == 1
    assert message in " ".join((tmp_path / "log").read_text().split())
    left = "withdrawn" if is_cancelled else "pending"
    assert left in {task["state"] for task in tasks_of(client, run_id)}
    client.cancel(run_id)


def test_the_owners_limits_hold_whatever_a_task_asks_for(service):
    client = service.client
    run_id = client.submit_run({**RUN, "seed": 2})["id"]
    robot, told = in_this_process(client, "tests.robots:fast_arm", Limits(seconds=0.5))
    with pytest.raises(InvalidInput, match=r"this robot may move for 0.5: allow --max-seconds"):
        robot.work()
    assert not robot._env.actions
    assert {t["state"] for t in tasks_of(client, run_id)} == {"pending"}  # for others
    client.cancel(run_id)
    assert told == ["here waits for episodes of arm"]


def test_a_sensor_that_fails_ends_the_client_and_the_run_waits_for_another(service):
    client = service.client
    run_id = client.submit_run({**RUN, "seed": 7})["id"]
    robot, _ = in_this_process(client, "tests.robots:blind_arm")
    with pytest.raises(RobotFailed, match=r"the robot showed \[nan, nan.* after 10 of"):
        robot.work()
    assert len(robot._env.actions) == 11
    assert {task["state"] for task in tasks_of(client, run_id)} == {"pending"}
    assert not client.get(run_id)["error"]
    client.cancel(run_id)


def test_actions_beyond_the_owners_limit_are_not_sent_and_recorded_as_sent(service):
    client = service.client
    spec = {**RUN, "method": "dropo", "collector": "random", "seed": 4, "iterations": 1}
    run_id = client.submit_run(spec)["id"]
    limits = Limits(actions=(0.25, 0.5))
    robot, told = in_this_process(client, "tests.robots:fast_arm", limits)
    robot.work(EPISODES_BEFORE_FIT)
    sent = np.abs(robot._env.actions)
    assert np.all(sent <= np.array([0.25, 0.5]))
    assert sent[:, 1].max() == pytest.approx(0.5)
    (line,) = [line for line in told if "rollout" in line]
    assert "actions at the owner's limit" in line
    (visit,) = [t for t in tasks_of(client, run_id) if t["kind"] == "rollout"]
    assert (visit["state"], visit["steps"]) == ("done", RUN["transitions"])
    with closing(sqlite3.connect(service.data_dir / "adr.sqlite")) as database:
        (content,) = database.execute(
            "select content from artifacts join stage_artifacts using (sha256) "
            "join target_tasks using (digest) where target_tasks.id = ?",
            [visit["id"]],
        ).fetchone()
    stored = TransitionDataset.from_npz(content).actions
    assert np.array_equal(stored, np.array(robot._env.actions)[-len(stored) :])
    client.cancel(run_id)


@pytest.mark.slow
def test_the_owner_can_stop_it_at_once_and_the_task_goes_back(service):
    client = service.client
    run_id = client.submit_run({**RUN, "seed": 6})["id"]
    robot, told = in_this_process(client, "tests.robots:slow_arm")
    with at_work(robot):
        until(lambda: robot._env.actions)
        robot.stop()
        until(lambda: any("stopped, by its owner" in line for line in told), 5)
    assert tasks_of(client, run_id)[0]["state"] == "pending"
    client.cancel(run_id)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"env": "tests.robots"}, "--env needs module:factory; given 'tests.robots'"),
        ({"env": "tests.robots:missing"}, "cannot be imported"),
        ({"env": "tests.robots:not_an_environment"}, "needed is a gymnasium.Env"),
        ({"task": "hopper"}, "the environment has observations"),
        ({"task": "hoper"}, "did you mean 'hopper'"),
        ({"limits": Limits(actions=(1.0, 1.0, 1.0))}, "3 limits given for 2 actions"),
        ({"limits": Limits(actions=(-1.0,))}, "limits of actions must be positive"),
    ],
)
def test_what_cannot_serve_is_told_before_anything_moves(service, changes, message):
    given = {"env": "tests.robots:fast_arm", **changes}
    with pytest.raises(InvalidInput, match=message):
        in_this_process(service.client, **given)


def test_an_upload_that_is_not_the_episode_is_refused_and_the_task_stays(service):
    client = service.client
    spec = {**RUN, "method": "dropo", "collector": "random", "seed": 5, "iterations": 1}
    run_id = client.submit_run(spec)["id"]
    claimed = client.claim_task("by hand", ["arm"])
    id, lease = claimed["task"]["id"], claimed["lease"]
    data = TransitionDataset(
        np.zeros((3, 4)), np.zeros((3, 2)), np.zeros((3, 4)), np.zeros(3), 0.02, ("x",) * 4, "t"
    )
    with pytest.raises(Refused, match="columns are x, x, x, x") as refused:
        client.complete_task(id, lease, data.to_npz())
    assert refused.value.status == 422
    (task,) = [t for t in tasks_of(client, run_id) if t["id"] == id]
    assert task["state"] == "claimed"
    client.release_task(id, lease)
    client.cancel(run_id)

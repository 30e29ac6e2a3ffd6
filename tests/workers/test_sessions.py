"""The folder of Ray's sessions: nobody else enters it, and nothing of earlier ones is left."""

import os
import signal
import stat
import subprocess
import sys
from contextlib import closing, contextmanager

import psutil
import pytest

from tests.service import until
from workers.sessions import Sessions, SessionsInUse

LEFTOVER = "import sys, time; file = open(sys.argv[1], 'w'); print(flush=True); time.sleep(600)"


@contextmanager
def process_of_ray(log_file):
    """A process that looks like one of Ray's: by its name, and by the log that it has open."""
    script = log_file.parent / "ray's code/agent.py"
    script.parent.mkdir(parents=True)
    script.write_text(LEFTOVER)
    command = [sys.executable, str(script), str(log_file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            process.stdout.readline()
            yield process
        finally:
            process.kill()


def test_only_the_owner_enters_the_folder_and_reads_the_token(tmp_path):
    with closing(Sessions(tmp_path)) as sessions:
        assert stat.S_IMODE((tmp_path / "ray").stat().st_mode) == 0o700
        assert stat.S_IMODE(sessions.token.stat().st_mode) == 0o600
        assert len(sessions.token.read_text()) == 64


def test_a_service_keeps_its_token_and_not_its_sessions(tmp_path):
    with closing(Sessions(tmp_path)) as first:
        token = first.token.read_text()
        (tmp_path / "ray/session_1/logs").mkdir(parents=True)
        (tmp_path / "ray/session_latest").symlink_to("session_1")
    with closing(Sessions(tmp_path)) as second:
        assert second.token.read_text() == token
        assert list((tmp_path / "ray").glob("session*")) == []


def test_two_services_cannot_have_one_folder(tmp_path):
    with closing(Sessions(tmp_path)), pytest.raises(SessionsInUse, match="another --data-dir"):
        Sessions(tmp_path)
    Sessions(tmp_path).close()


def test_a_long_path_has_a_short_one_that_is_ours_alone(tmp_path):
    folder = tmp_path / ("x" * 100)
    folder.mkdir()
    for _ in range(2):  # the second finds the first one's short path
        with closing(Sessions(folder)) as sessions:
            assert len(str(sessions.path)) < 40
            assert sessions.path.samefile(folder / "ray")
            assert stat.S_IMODE(sessions.path.parent.stat().st_mode) == 0o700
            paths = [sessions.path.parent]
    Sessions(folder).close()
    assert not paths[0].exists()


@pytest.mark.parametrize("is_stopped", [False, True])
def test_what_earlier_sessions_left_running_is_ended(tmp_path, is_stopped, monkeypatch):
    monkeypatch.setattr("workers.sessions._RAYS_CODE", "ray's code/")
    logs = tmp_path / "ray/session_1/logs"
    logs.mkdir(parents=True)
    with process_of_ray(logs / "x.log") as left, process_of_ray(tmp_path / "other.log") as other:
        if is_stopped:
            os.kill(left.pid, signal.SIGSTOP)
            until(lambda: psutil.Process(left.pid).status() == psutil.STATUS_STOPPED)
        Sessions(tmp_path).close()
        assert left.wait(timeout=10) is not None  # else it is still there
        assert other.poll() is None

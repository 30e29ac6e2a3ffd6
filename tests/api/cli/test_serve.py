"""The command that starts the service."""

import os
import socket
import subprocess
import sys

import pytest


@pytest.mark.ray
@pytest.mark.slow
def test_a_service_that_cannot_compute_any_more_ends_with_status_1(tmp_path):
    """So that a supervisor starts it again, which no health check does everywhere."""
    code = """
from workers.dispatcher import Dispatcher
def broken(self):
    raise RuntimeError("no Ray again")
Dispatcher._loop = broken
from api.cli import main
main()
"""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    command = [sys.executable, "-c", code, "serve", "--port", port, "--cpus", "1"]
    done = subprocess.run(
        [*command, "--data-dir", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 1
    assert "the dispatcher stopped" in done.stderr
    assert "the service ends, because it cannot compute any more" in done.stderr


def test_a_port_in_use_is_refused_before_anything_starts(tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        command = [sys.executable, "-m", "api", "serve", "--port", port, "--data-dir", "other"]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=60, cwd=tmp_path, check=False
        )
    assert done.returncode == 2
    assert f"cannot listen on 127.0.0.1 port {port}" in done.stderr
    assert "choose another port with --port" in done.stderr
    assert not (tmp_path / "other").exists()


def test_mistakes_in_settings_and_folders_are_told_before_the_service_is_imported(tmp_path):
    (nowhere := tmp_path / "file").write_text("")  # so that it ends, before it imports this:
    (tmp_path / "uvicorn.py").write_text("raise RuntimeError")
    command = [sys.executable, "-m", "api", "serve", "--port", "0", "--cpus", "9999"]
    done = subprocess.run(
        [*command, "--data-dir", str(nowhere)],
        env={**os.environ, "ADR_TOKENS": "s" * 16, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 2
    assert "ADR_TOKENS is no setting, and has no effect; did you mean ADR_TOKEN?" in done.stderr
    assert "ADR_CPUS is 9999, but" in done.stderr
    assert "there can be no data in" in done.stderr

"""Processes that are started again when they die, as systemd or a container engine does it."""

import os
import signal
import subprocess
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

import psutil

from tests.service import children_of, free_port, serve_command

_RESTART_S = 1.0


class Supervised:
    """A process that is started again when it has ended; its output goes on in one log."""

    def __init__(self, command: Sequence[object], log: Path, environment: Mapping[str, str]):
        self.log = log
        self._command, self._environment = [str(word) for word in command], environment
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._keep)

    def __enter__(self) -> Self:
        self._process = self._begin()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        self._process.terminate()
        self._process.wait(timeout=60)

    def signal(self, number: int) -> bool:
        """Send a signal; False if no process runs now."""
        is_running = self._process.poll() is None
        self._process.send_signal(number)
        return is_running

    def kill_child(self, title: str) -> bool:
        """Kill a process under it with these words in its title; False if there is none."""
        with suppress(psutil.NoSuchProcess, ProcessLookupError):  # they end meanwhile
            for pid, words in children_of(self._process.pid).items():
                if title in words:
                    os.kill(pid, signal.SIGKILL)
                    return True
        return False

    def _keep(self) -> None:
        while not self._closing.wait(_RESTART_S):
            if self._process.poll() is not None:
                self._process = self._begin()

    def _begin(self) -> subprocess.Popen[bytes]:
        its_own = {**os.environ, **self._environment}
        with self.log.open("ab") as output:
            return subprocess.Popen(
                self._command, stdout=output, stderr=subprocess.STDOUT, env=its_own
            )


class SupervisedService(Supervised):
    """The service at one address, whatever becomes of its processes."""

    def __init__(self, folder: Path, environment: Mapping[str, str]):
        port = free_port()
        self.url = f"http://127.0.0.1:{port}"
        command = [*serve_command(folder, port, cpus=2), "--no-dashboard"]
        super().__init__(command, folder / "service.log", {**environment, "HOME": str(folder)})

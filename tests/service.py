"""A real service in another process, for tests that talk to it or kill it."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import psutil

from adr_service.client import AdrClient, Unreachable

START_TIMEOUT_S = 120
T = TypeVar("T")


class NotStarted(RuntimeError):
    """The service ended, or did not answer, before it was ready."""

    def __init__(self, status: int | None, log: str):
        super().__init__(f"the service did not start ({status}):\n{log}")
        self.status = status


@dataclass
class RunningService:
    process: subprocess.Popen[bytes]
    client: AdrClient
    data_dir: Path
    log: Path

    def kill(self) -> None:
        """SIGKILL, as a crash would."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(timeout=30)

    @property
    def started_stages(self) -> list[str]:
        """Digests of the stages this process has started, in order, from its log."""
        return [digest for digest, _ in self.attempts]

    @property
    def attempts(self) -> list[tuple[str, int]]:
        """(digest, number of the attempt) of the same."""
        return attempts_in(self.log)

    @property
    def children(self) -> dict[int, str]:
        """Pids and titles of the Ray workers under this process."""
        return children_of(self.process.pid)


@contextmanager
def start_service(
    data_dir: Path,
    *,
    cpus: int | None,
    environment: Mapping[str, str] | None = None,
    dashboard: bool = False,
    wrapper: Sequence[str] = (),
    adr: Sequence[str] = (sys.executable, "-m", "api"),
    cwd: Path | None = None,
) -> Generator[RunningService]:
    """A service on a free port; terminated by pid when the block ends.

    Ray's dashboard costs as much as a small test. `wrapper` is a command that runs another in its
    own place, `adr` the command line of an installation.
    """
    port = free_port()
    log = data_dir / f"service-{port}.log"
    command = [*wrapper, *serve_command(data_dir, port, cpus, adr)]
    command += ["--dashboard" if dashboard else "--no-dashboard"]
    # Ray's default folder is shared by everyone on the machine; ours must be short for sockets
    its_own = {**os.environ, "HOME": str(data_dir), **(environment or {})}
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=its_own, cwd=cwd
        )
    try:
        with AdrClient(f"http://127.0.0.1:{port}", its_own.get("ADR_TOKEN", "")) as client:
            _wait(client, process, log)
            yield RunningService(process, client, data_dir, log)
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait(timeout=60)


def children_of(pid: int) -> dict[int, str]:
    """Pids and titles of the processes under another."""
    found: dict[int, str] = {}
    for child in psutil.Process(pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # it has ended meanwhile
            found[child.pid] = " ".join(child.cmdline()).strip()
    return found


def attempts_in(log: Path) -> list[tuple[str, int]]:
    """(digest, number of the attempt) of the stages that a service has begun, from its log."""
    found = re.findall(r"stage begun .*attempt=(\d+) .*stage=(\w{64})", log.read_text())
    return [(digest, int(number)) for number, digest in found]


def serve_command(
    data_dir: Path,
    port: int,
    cpus: int | None,
    adr: Sequence[str] = (sys.executable, "-m", "api"),
) -> list[str]:
    """`adr serve`; `cpus` None: of a cluster that is there."""
    command = [*adr, "serve", "--port", str(port), "--data-dir", str(data_dir)]
    return command if cpus is None else [*command, "--cpus", str(cpus)]


def free_port() -> int:
    """A port that nothing uses, between those of Ray's workers and those of connections.

    A service takes seconds before it listens, and Ray connects meanwhile.
    """
    rng = np.random.default_rng()
    while True:
        port = int(rng.integers(20_000, 32_000))
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def wait_until_finished(client: AdrClient, id: str, timeout_s: float) -> dict[str, object]:
    deadline = time.monotonic() + timeout_s
    for seen in client.watch(id):
        if time.monotonic() > deadline:
            raise TimeoutError(f"{id} did not finish in {timeout_s} s: {seen}")
        last = seen
    return last


def until(condition: Callable[[], T], seconds: float = 120) -> T:
    """Wait for something that another process does; what it was."""
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)  # it can only be asked again
    return found


def _wait(client: AdrClient, process: subprocess.Popen[bytes], log: Path) -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline and process.poll() is None:
        try:
            client.ready()
        except Unreachable:
            time.sleep(0.1)  # a process that starts can only be asked again
        else:
            return
    raise NotStarted(process.poll(), log.read_text()[-3000:])

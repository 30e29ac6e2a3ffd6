"""Ray's control process (GCS), which may die under a service that goes on.

A call to a dead GCS blocks, and Ray ends a process whose call has blocked for a minute. `OwnGcs`
starts the GCS of a local cluster again, with its tables, so that nobody else notices. `JoinedGcs`
says that another's GCS is dead, before anything is asked of it.
"""

import ctypes
import logging
import signal
import socket
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import psutil

log = logging.getLogger(__name__)
_LOOK_S = 0.5
_FIND_S = 0.05  # a GCS that dies before it was found cannot be started again
_SHORT_LIFE_S = 5.0
_SHORT_LIVES = 3  # one after the other: it cannot be started any more
_ANSWER_S = 5.0  # in which TCP asks again twice, where a packet was lost
_KEEPALIVE_S = 5
_SIGNAL_AT_PARENTS_DEATH = 1  # PR_SET_PDEATHSIG of Linux
_PORT = "--gcs_server_port="


class OwnGcs:
    """Looks after the GCS that `ray.init` starts, on a thread of its own."""

    def __init__(self, folder: Path):
        # on disk, which Ray calls an alpha feature; by default a GCS forgets everything
        self.config = {"gcs_storage": "rocksdb", "gcs_storage_path": str(folder / "session_gcs")}
        self._stopping, self._left, self._over = (threading.Event() for _ in range(3))
        self._thread = threading.Thread(target=self._run, name="gcs", daemon=True)
        self._started: psutil.Popen | None = None
        self.is_alive = True  # or will be in a moment

    def start(self) -> None:
        """Start watching. Call it before `ray.init`, which a dead GCS would block."""
        self._thread.start()

    def leave_alone(self) -> None:
        """Stop watching. Call it before `ray.shutdown`, which ends the GCS that Ray started."""
        self._stopping.set()
        self._left.wait()

    def end(self) -> None:
        """End the GCS that was started here, if any; after `ray.shutdown`."""
        if self._started is not None:
            self._started.kill()
            self._started.wait()
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            self._keep()
        except Exception:
            log.exception("Ray's GCS cannot be looked after any more")
            self.is_alive = False
        finally:
            self._left.set()
        self._over.wait()  # a GCS that was started here dies with this thread

    def _keep(self) -> None:
        process: psutil.Process | None = None
        command: list[str] = []
        since, short_lives = time.monotonic(), 0
        while not self._stopping.wait(_FIND_S if process is None else _LOOK_S):
            if process is None:
                process, command = _found()
            elif not lives(process):
                is_short = time.monotonic() - since < _SHORT_LIFE_S
                short_lives = short_lives + 1 if is_short else 0
                if short_lives == _SHORT_LIVES:
                    log.warning("Ray's GCS does not start again")
                    self.is_alive = False
                    return
                log.warning("Ray's GCS has died; starting it again")
                if self._started is not None:
                    self._started.wait()  # it is dead
                process = self._started = _started(_at_its_port(command))
                since = time.monotonic()


class JoinedGcs:
    """Keeps a connection to a GCS, which ends with it."""

    def __init__(self, address: str):
        self.address = address
        self._connection: socket.socket | None = None

    @property
    def is_alive(self) -> bool:
        """True if the connection stands, or another one can be made."""
        if self._connection is None or _has_ended(self._connection):
            self.close()
            self._connection = _connected(self.address)
        return self._connection is not None

    def close(self) -> None:
        """End the connection."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def lives(process: psutil.Process) -> bool:
    """True unless a process has ended."""
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def child(name: str) -> psutil.Process | None:
    """A process of a name that this one has started."""
    for process in psutil.Process().children():
        with suppress(psutil.NoSuchProcess):
            if process.name() == name and lives(process):
                return process
    return None


def _found() -> tuple[psutil.Process | None, list[str]]:
    """The GCS and its command line, once it has been started."""
    process = child("gcs_server")
    if process is not None:
        with suppress(psutil.NoSuchProcess):
            if command := process.cmdline():  # it has none yet while it is being executed
                return process, command
    return None, []


def _started(command: Sequence[str]) -> psutil.Popen:
    """A process that does not outlive the thread that starts it, as Ray's own do not."""
    libc = ctypes.CDLL(None)
    return psutil.Popen(
        command, preexec_fn=lambda: libc.prctl(_SIGNAL_AT_PARENTS_DEATH, signal.SIGKILL)
    )


def _at_its_port(command: Sequence[str]) -> list[str]:
    """The command that starts the GCS again at its old port, or at any port if it had none yet."""
    given = dict(argument.removeprefix("--").split("=", 1) for argument in command[1:])
    file = Path(given["session-dir"]) / f"gcs_server_port_{given['node-id']}"
    port = (file.exists() and file.read_text()) or "0"
    return [f"{_PORT}{port}" if each.startswith(_PORT) else each for each in command]


def _connected(address: str) -> socket.socket | None:
    host, _, port = address.rpartition(":")
    try:
        connection = socket.create_connection((host.strip("[]"), int(port)), _ANSWER_S)
    except OSError:
        return None
    # the machine of a GCS may vanish without a word
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL):
        connection.setsockopt(socket.IPPROTO_TCP, option, _KEEPALIVE_S)
    connection.setblocking(False)
    return connection


def _has_ended(connection: socket.socket) -> bool:
    """True once the other side has closed it; what it says is ignored."""
    try:
        return not connection.recv(4096)
    except BlockingIOError:
        return False
    except OSError:
        return True

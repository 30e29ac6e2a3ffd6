"""The folder of a local Ray cluster's sockets, logs and token, which nobody else can enter.

    sessions = Sessions(data_dir)       # SessionsInUse if another service has it
    ray.init(_temp_dir=str(sessions.path))

By default Ray uses a folder under the shared temporary one, and lets everybody write there: another
user could put sockets in the place of Ray's.
"""

import atexit
import fcntl
import logging
import os
import secrets
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

import psutil
import ray

from adr_service.errors import AdrError
from adr_service.whole_files import written_whole

log = logging.getLogger(__name__)
_LONGEST_SOCKET = 107  # bytes of a socket's path, which Linux allows
_IN_A_SESSION = len("/session_2026-11-23_03-29-21_873217_1234567/sockets/dash_MetricsHead")
_RAYS_CODE = f"{Path(ray.__file__).parent}/"
_END_S = 5.0  # for killed processes to be gone


class SessionsInUse(AdrError):
    """Another service keeps its Ray in this folder."""

    code = "cluster_unavailable"


class Sessions:
    """The sessions of one service; those of an earlier service are removed.

    `folder` is the service's own; None stands for a temporary one, deleted at exit.
    """

    def __init__(self, folder: Path | None):
        if folder is None:
            folder = Path(tempfile.mkdtemp(prefix="adr-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
        self._home = folder.absolute() / "ray"
        self._home.mkdir(mode=0o700, exist_ok=True)
        self._home.chmod(0o700)
        self._lock = os.open(self._home, os.O_RDONLY)  # as long as this process lives
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._lock)
            raise SessionsInUse(
                f"another service keeps its Ray in {self._home}; give this one another --data-dir"
            ) from None
        self._link = self._home / "short_path"
        if self._link.is_symlink():  # a service that was killed did not remove it
            _remove_short_path(Path(os.readlink(self._link)))
            self._link.unlink()
        self.clear()
        self.token = _token(folder.absolute() / "ray_token")
        self.path = self._short_path()

    def clear(self) -> None:
        """End what earlier sessions left running, and remove their folders."""
        _end_processes_of(self._home)
        for path in self._home.glob("session_*"):
            if path.is_symlink():
                path.unlink()
            else:
                shutil.rmtree(path, ignore_errors=True)

    def close(self) -> None:
        """Let another service have the folder."""
        os.close(self._lock)

    def _short_path(self) -> Path:
        """A path to our folder that leaves room for the names of Ray's sockets."""
        if len(os.fsencode(self._home)) + _IN_A_SESSION <= _LONGEST_SOCKET:
            return self._home
        short = Path(tempfile.mkdtemp(prefix="adr-"))  # which nobody else can enter either
        (short / "ray").symlink_to(self._home)
        self._link.symlink_to(short)
        atexit.register(_remove_short_path, short)
        return short / "ray"


def is_in_use(folder: Path) -> bool:
    """True if a service that runs keeps its Ray in this folder."""
    home = folder / "ray"
    if not home.is_dir():
        return False
    lock = os.open(home, os.O_RDONLY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(lock)
    return False


def _remove_short_path(short: Path) -> None:
    with suppress(OSError):  # it is gone, or not ours
        (short / "ray").unlink()
        short.rmdir()


def _token(path: Path) -> Path:
    """The secret of our own Ray cluster, readable by nobody else (Ray's own is, by all)."""
    if not path.exists():
        with written_whole(path, mode=0o600) as part:  # Ray does not start with an empty one
            part.write_text(secrets.token_hex(32))
    return path


def _end_processes_of(home: Path) -> None:
    """Kill Ray's processes of earlier sessions: agents and stopped workers outlive their raylet.

    They have logs open in the folder, whose lock we hold.
    """
    inside, ended = f"{home.resolve()}/", list[psutil.Process]()
    for process in psutil.process_iter():
        with suppress(psutil.Error):  # it has ended, or is somebody else's
            if process.pid == os.getpid() or process.uids().real != os.getuid():
                continue
            title = " ".join(process.cmdline()[:3])
            if not title.startswith(("ray::", "ray-")) and _RAYS_CODE not in title:
                continue
            if any(file.path.startswith(inside) for file in process.open_files()):
                process.kill()
                ended.append(process)
    if ended:
        log.warning("ended %d processes that an earlier session of Ray left behind", len(ended))
    psutil.wait_procs(ended, timeout=_END_S)

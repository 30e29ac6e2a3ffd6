"""Episodes that the service does not have yet, in files of the robot's working directory.

An episode is written before it is sent, with the lease of its task beside it. Whatever ends the
client, the next one that starts in the same folder sends it.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from adr_service.errors import InvalidInput
from adr_service.whole_files import written_whole

_SHOWN = 8  # letters of a lease


@dataclass(frozen=True)
class UnsentEpisode:
    """An episode of a task, and the file that has it."""

    task_id: str
    lease: str
    content: bytes  # .npz
    file: Path | None  # None: it could not be written

    @classmethod
    def written(cls, task_id: str, lease: str, content: bytes) -> "UnsentEpisode":
        """The episode in TASK.npz, with the lease in TASK.lease; each is whole or not there."""
        file = Path(f"{task_id}.npz").absolute()
        try:
            # both first: an episode must never be sent with the lease of another
            _lease_file(file).unlink(missing_ok=True)
            file.unlink(missing_ok=True)
            _write(_lease_file(file), lease.encode())  # first: the next client sends only pairs
            _write(file, content)
        except OSError:
            if file.exists():
                return cls(task_id, lease, content, file)
            with suppress(OSError):
                _lease_file(file).unlink(missing_ok=True)  # of no episode
            return cls(task_id, lease, content, None)
        return cls(task_id, lease, content, file)

    @classmethod
    def all_here(cls) -> Iterator["UnsentEpisode"]:
        """Episodes that an earlier client left, in order of their names.

        Raises InvalidInput for one that cannot be read.
        """
        for lease in sorted(Path.cwd().glob("task_*.lease")):
            file = lease.with_suffix(".npz")
            try:
                yield cls(lease.stem, lease.read_text(), file.read_bytes(), file)
            except FileNotFoundError:
                continue  # another client has sent it, or the last one ended before it was written
            except OSError as error:  # as after `sudo`
                raise InvalidInput(
                    f"{file} and {lease.name}, which an earlier client left, cannot be read: "
                    f"{error.strerror}. Start the client as that one's user, or move both to "
                    "another folder"
                ) from error

    def discard(self) -> None:
        """Delete what the service has; raises OSError."""
        if self.file is not None:
            _lease_file(self.file).unlink(missing_ok=True)
            self.file.unlink(missing_ok=True)

    def set_aside(self) -> "UnsentEpisode":
        """Give it a name of its own, because it is not sent again, and its task may come back.

        The lease stays beside it, in case that another service than the right one was asked.
        """
        if self.file is None:
            return self
        aside = self.file.with_suffix(f".{self.lease[:_SHOWN]}.npz")
        try:
            _lease_file(self.file).replace(aside.with_suffix(".lease_kept"))
            self.file.replace(aside)
        except OSError:  # another client has done it, or nothing can be written any more
            return self
        return UnsentEpisode(self.task_id, self.lease, self.content, aside)


def _lease_file(file: Path) -> Path:
    return file.with_suffix(".lease")


def _write(path: Path, content: bytes) -> None:
    with written_whole(path, mode=0o600) as part:  # a lease is a secret
        part.write_bytes(content)

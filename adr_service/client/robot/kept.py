"""Episodes that the service does not have yet, as files in the robot's working directory.

An episode is written before it is sent, with the lease of its task beside it. Whatever ends the
client, the next one that starts in the same folder sends it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Kept:
    """The files of one episode."""

    file: Path  # TASK.npz; beside it TASK.lease

    @classmethod
    def write(cls, task_id: str, lease: str, content: bytes) -> "Kept":
        kept = cls(Path(f"{task_id}.npz").absolute())
        kept.file.write_bytes(content)
        part = kept.file.with_suffix(".part")
        part.touch(mode=0o600)
        part.write_text(lease)
        part.replace(kept._lease_file)  # whole or not at all, for another client in this folder
        return kept

    @classmethod
    def all_here(cls) -> Iterator["Kept"]:
        """Episodes that can still be sent, in order of their names."""
        for lease in sorted(Path.cwd().glob("task_*.lease")):
            if (kept := cls(lease.with_suffix(".npz"))).file.exists():
                yield kept

    @property
    def task_id(self) -> str:
        return self.file.stem

    @property
    def lease(self) -> str:
        return self._lease_file.read_text()

    def discard(self) -> None:
        """Delete an episode that the service has."""
        self.file.unlink(missing_ok=True)
        self.give_up()

    def give_up(self) -> None:
        """Never send it again; the episode stays."""
        self._lease_file.unlink(missing_ok=True)

    @property
    def _lease_file(self) -> Path:
        return self.file.with_suffix(".lease")

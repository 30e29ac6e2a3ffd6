"""Files that are written as a whole or not at all."""

import errno
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path, mode: int = 0o666) -> Generator[Path]:
    """A new, empty file beside `path`, which takes the place of `path` when the block ends.

    If the block fails, or the process or the power dies, `path` stays as it was. `mode` is the
    file's permissions, less the umask. Raises OSError if nothing can be written.
    """
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    try:
        part.touch(mode)
        yield part
        _sync(part)
        part.replace(path)
        _sync_names(path.parent)
    finally:
        part.unlink(missing_ok=True)


def _sync_names(folder: Path) -> None:
    """Wait for the names in a folder, if its file system can, and its user may read it."""
    try:
        _sync(folder)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EACCES):
            raise


def _sync(path: Path) -> None:
    """Wait until a file's bytes, or a folder's names, are on the disk."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)

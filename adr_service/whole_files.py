"""Files that are written as a whole or not at all."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path, mode: int = 0o666) -> Generator[Path]:
    """A new, empty file beside `path` to write to, which takes its place at the end.

    If anything fails, or the process dies, what was at `path` stays. `mode` has the file's
    permissions, of which the process's umask takes some. Raises OSError where nothing can be
    written.
    """
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    try:
        part.touch(mode)
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)

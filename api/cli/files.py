"""Files that commands read, and those that they write. None is overwritten."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from adr_service.errors import InvalidInput


def read(file: Path) -> bytes:
    """The content of a file; raises InvalidInput if it cannot be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise InvalidInput(f"{file} cannot be read: {error.strerror}") from error


def read_text(file: Path) -> str:
    """The text of a file, without the mark with which Windows begins UTF-8; raises InvalidInput if
    it cannot be read, or is no UTF-8."""
    try:
        return read(file).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidInput(f"{file}: it is no text in UTF-8: {error}") from error


@contextmanager
def naming(file: Path) -> Generator[None]:
    """Let a refusal of a file's content begin with the file's name."""
    try:
        yield
    except InvalidInput as error:
        raise InvalidInput(f"{file}: {error}") from error


def check_absent(*paths: Path) -> None:
    """Raise InvalidInput for the first of these files and folders that is there already."""
    for path in paths:
        if os.path.lexists(path):  # a link that leads nowhere is there as well
            raise InvalidInput(f"{path} is there already; give another name, or delete it first")


def check_writable(*files: Path) -> None:
    """Raise InvalidInput unless these files can be written, and none is there. Makes folders."""
    check_absent(*files)
    for file in files:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.touch()
            file.unlink()
        except OSError as error:
            raise InvalidInput(f"{file} cannot be written: {error.strerror}") from error


def check_new(file: Path) -> None:
    """Raise InvalidInput for a file that is there already, or whose folder is not."""
    check_absent(file)
    if not file.parent.is_dir():
        raise InvalidInput(f"there is no folder {file.parent} to write {file.name} into")

"""Files that commands write. None is overwritten."""

from pathlib import Path

from adr_service.errors import InvalidInput


def check_absent(*paths: Path) -> None:
    """Raise InvalidInput for the first of these files and folders that is there already."""
    for path in paths:
        if path.exists():
            raise InvalidInput(f"{path} is there already; give another name, or delete it first")


def check_new(file: Path) -> None:
    """Raise InvalidInput for a file that is there already, or whose folder is not."""
    check_absent(file)
    if not file.parent.is_dir():
        raise InvalidInput(f"there is no folder {file.parent} to write {file.name} into")

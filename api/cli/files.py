"""Files that commands write."""

from pathlib import Path

from adr_service.errors import InvalidInput


def check_new(file: Path) -> None:
    """Raise InvalidInput for a file that is there already, or whose folder is not."""
    if file.exists():
        raise InvalidInput(f"{file} is there already; an export overwrites nothing")
    if not file.parent.is_dir():
        raise InvalidInput(f"there is no folder {file.parent} to write {file.name} into")

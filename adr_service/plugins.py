"""Extensions by installed packages: the entry points of our groups."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from adr_service.errors import InvalidInput


def installed(group: str) -> list[EntryPoint]:
    """The entry points of a group, by name."""
    return sorted(entry_points(group=group), key=lambda point: point.name)


def load(point: EntryPoint) -> Any:
    """Import the object that an entry point names."""
    try:
        return point.load()
    # a foreign module may raise anything while it is imported, or even exit
    except (Exception, SystemExit) as error:
        raise InvalidInput(f"{origin(point)} cannot be loaded: {error!r}") from error


@cache  # called for every stage; reading all installed packages takes milliseconds
def package_of(group: str, name: str) -> str | None:
    """Name and version of the package that adds `name` to a group; None for our own members."""
    for point in installed(group):
        if point.name == name and point.dist is not None:
            return f"{point.dist.name} {point.dist.version}"
    return None


def origin(point: EntryPoint) -> str:
    """Description of an entry point for error messages."""
    package = f" of the package {point.dist.name}" if point.dist else ""
    return f"entry point {point.name!r} = {point.value!r}{package} (group {point.group})"

"""Extensions by installed packages: the entry points of our groups."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, cast

from adr_service.errors import InvalidInput

TASKS, METHODS = "adr_service.tasks", "adr_service.methods"  # our groups
# inputs of stages that name a package: the group that it adds to, and the input that it adds
PACKAGES = {
    "package": (TASKS, "task"),
    "method_package": (METHODS, "method"),
    "curriculum_package": (METHODS, "curriculum"),
}


def installed(group: str) -> list[EntryPoint]:
    """The entry points of a group, by name."""
    return sorted(entry_points(group=group), key=lambda point: point.name)


def load(point: EntryPoint) -> Any:
    """Import the object that an entry point names.

    `package_of` gives the version of this moment from now on: an upgrade changes no imported code.
    """
    package_of(point.group, point.name)
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


@dataclass(frozen=True)
class OtherVersion:
    """A package with its version, in a stage and in this process."""

    of_stage: str
    here: str


def other_versions(inputs: Mapping[str, Any]) -> dict[str, OtherVersion]:
    """The packages that this process has in another version than a stage is of.

    Takes the stage's inputs as JSON, and passes over those of another form, as an import may bring;
    the keys are those of the inputs that name a package.
    """
    others: dict[str, OtherVersion] = {}
    for field, (group, member) in PACKAGES.items():
        of_stage, added = inputs.get(field), inputs.get(member)
        # a task's name, or a method's settings
        name = cast(Mapping[str, Any], added).get("name") if isinstance(added, Mapping) else added
        if not isinstance(of_stage, str) or not isinstance(name, str):
            continue
        here = package_of(group, name)
        if here is not None and here != of_stage:
            others[field] = OtherVersion(of_stage, here)
    return others


def origin(point: EntryPoint) -> str:
    """Description of an entry point for error messages."""
    package = f" of the package {point.dist.name}" if point.dist else ""
    return f"entry point {point.name!r} = {point.value!r}{package} (group {point.group})"

"""The tasks by name, with their variants and so with the truth that targets hide.

Ours, and those of installed packages: an entry point of the group `adr_service.tasks` names an
`Entry` (docs/own-task.md has a complete package).
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from adr_service.errors import InvalidInput, UnknownName
from adr_service.tasks import arm, half_cheetah, hopper, humanoid, walker2d
from adr_service.tasks.base import Entry, Hidden, Source, Task, Variant

GROUP = "adr_service.tasks"
BUILT_IN: Mapping[str, Entry] = {
    entry.task.name: entry
    for entry in (
        Entry(arm.Arm(), arm.variants()),
        Entry(hopper.Hopper(), hopper.variants()),
        Entry(half_cheetah.HalfCheetah(), half_cheetah.variants()),
        Entry(walker2d.Walker2d(), walker2d.variants()),
        Entry(humanoid.Humanoid(), humanoid.variants()),
    )
}


@cache
def catalogue() -> Mapping[str, Entry]:
    """All tasks by name: ours, then those of installed packages."""
    entries = dict(BUILT_IN)
    for point in _installed():
        entry = _load(point)
        if entry.task.name in entries:
            raise InvalidInput(
                f"{_origin(point)} gives a task {entry.task.name!r}, which there is already"
            )
        entries[entry.task.name] = entry
    return entries


def get_task(name: str) -> Task:
    return _entry(name).task


def variants_of(task: str) -> Mapping[str, Variant]:
    return _entry(task).variants


def variant_of(task: str, variant: str) -> Variant:
    if variant not in variants_of(task):
        raise UnknownName(f"variant of {task}", variant, variants_of(task))
    return variants_of(task)[variant]


def source_of(task: str, variant: str) -> Source:
    """What methods may simulate of a task's variant."""
    return variant_of(task, variant).source


def hidden_of(task: str, variant: str) -> Hidden:
    """The truth behind a variant's target. For simulated targets and environments alone."""
    return variant_of(task, variant).hidden


@cache
def identity_of(task: str) -> Mapping[str, str]:
    """What a stage's inputs say of a task: its name, and the version of a foreign package.

    Changes of our own tasks are changes of the stage kinds' versions.
    """
    for point in _installed():
        if point.name == task and point.dist is not None:
            return {"task": task, "package": f"{point.dist.name} {point.dist.version}"}
    return {"task": task}


def _installed() -> list[EntryPoint]:
    return sorted(entry_points(group=GROUP), key=lambda point: point.name)


def _load(point: EntryPoint) -> Entry:
    try:
        entry = point.load()
    # a foreign module may raise anything while it is imported
    except Exception as error:
        raise InvalidInput(f"{_origin(point)} cannot be loaded: {error!r}") from error
    if not isinstance(entry, Entry):
        raise InvalidInput(
            f"{_origin(point)} must name an adr_service.tasks.base.Entry; it is {entry!r}"
        )
    if entry.task.name != point.name:
        raise InvalidInput(f"{_origin(point)} gives a task of another name, {entry.task.name!r}")
    return entry


def _origin(point: EntryPoint) -> str:
    package = f" of the package {point.dist.name}" if point.dist else ""
    return f"entry point {point.name!r} = {point.value!r}{package} (group {GROUP})"


def _entry(task: str) -> Entry:
    if task not in catalogue():
        raise UnknownName("task", task, catalogue())
    return catalogue()[task]

"""The tasks by name, with their variants and so with the truth that targets hide.

Ours, and those of installed packages: an entry point of the group `adr_service.tasks` names an
`Entry` (docs/own-task.md has a complete package).
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

from adr_service.effects.base import parse_domain
from adr_service.errors import InvalidInput, UnknownName
from adr_service.plugins import installed, load, origin, package_of
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
    for point in installed(GROUP):
        entry = load(point)
        if not isinstance(entry, Entry):
            raise InvalidInput(
                f"{origin(point)} must name an adr_service.tasks.base.Entry; it is {entry!r}"
            )
        if entry.task.name != point.name:
            raise InvalidInput(f"{origin(point)} gives a task of another name, {entry.task.name!r}")
        if entry.task.name in entries:
            raise InvalidInput(
                f"{origin(point)} gives a task {entry.task.name!r}, which there is already"
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


def source_of(task: str, domain: str) -> Source:
    """What methods may simulate of a task's variant, with the effects that the domain adds."""
    variant, effects = parse_domain(domain)
    return replace(variant_of(task, variant).source, effects=effects)


def hidden_of(task: str, domain: str) -> Hidden:
    """The truth behind a variant's target, with the effects that the domain adds.

    For simulated targets and environments alone.
    """
    variant, effects = parse_domain(domain)
    hidden = variant_of(task, variant).hidden
    return replace(hidden, source=replace(hidden.source, effects=effects))


def identity_of(task: str) -> Mapping[str, str]:
    """What a stage's inputs say of a task: its name, and the version of a foreign package.

    Changes of our own tasks are changes of the stage kinds' versions.
    """
    package = package_of(GROUP, task)
    return {"task": task} if package is None else {"task": task, "package": package}


def _entry(task: str) -> Entry:
    if task not in catalogue():
        raise UnknownName("task", task, catalogue())
    return catalogue()[task]

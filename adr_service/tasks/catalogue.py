"""The tasks by name, with their variants and so with the truth that targets hide.

Our own tasks are the modules of this package that have an `ENTRY`: to add one, add its file.
Installed packages add theirs by an entry point of the group `adr_service.tasks` that names an
`Entry` (docs/own-task.md has a complete package).
"""

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint

import numpy as np

from adr_service import tasks
from adr_service.effects.base import parse_domain
from adr_service.errors import InvalidInput, UnknownName
from adr_service.plugins import TASKS, installed, load, origin, package_of
from adr_service.tasks.base import Entry, Hidden, Source, Task, Variant

_NO_TASKS = {"catalogue", "check"}  # modules of the package that import this one


def _built_in() -> Mapping[str, Entry]:
    """The tasks of this package, those with few parameters first."""
    names = {module.name for module in pkgutil.iter_modules(tasks.__path__)} - _NO_TASKS
    modules = [importlib.import_module(f"{tasks.__name__}.{name}") for name in names]
    entries: list[Entry] = [module.ENTRY for module in modules if hasattr(module, "ENTRY")]
    return {entry.task.name: entry for entry in sorted(entries, key=_size)}


def _size(entry: Entry) -> tuple[int, str]:
    """Parameters of the largest variant, then the name."""
    spaces = [variant.source.space for variant in entry.variants.values()]
    return max(map(len, spaces)), entry.task.name


BUILT_IN = _built_in()


@cache
def catalogue() -> Mapping[str, Entry]:
    """All tasks by name: ours, then those of installed packages."""
    entries = dict(BUILT_IN)
    for point in installed(TASKS):
        entry = _loaded(point)
        if entry.task.name in entries:
            raise InvalidInput(
                f"{origin(point)} gives a task {entry.task.name!r}, but there is one already"
            )
        entries[entry.task.name] = entry
    return entries


def variants() -> list[str]:
    """The names of all tasks' variants, each once."""
    return list(dict.fromkeys(name for entry in catalogue().values() for name in entry.variants))


def _loaded(point: EntryPoint) -> Entry:
    entry = load(point)
    if not isinstance(entry, Entry):
        raise InvalidInput(
            f"{origin(point)} must name an adr_service.tasks.base.Entry; it is {entry!r}"
        )
    if entry.task.name != point.name:
        raise InvalidInput(f"{origin(point)} gives a task of another name, {entry.task.name!r}")
    return entry


def get_task(name: str) -> Task:
    return _entry(name).task


def variants_of(task: str) -> Mapping[str, Variant]:
    return _entry(task).variants


def variant_of(task: str, variant: str) -> Variant:
    if variant not in variants_of(task):
        raise UnknownName(f"variant of {task}", variant, variants_of(task))
    return variants_of(task)[variant]


def first_like(task: str, variant: str) -> str:
    """The first variant with the same source, so that equal trainings have equal inputs."""
    source = variant_of(task, variant).source
    return next(name for name, other in variants_of(task).items() if other.source == source)


def target_like(task: str, variant: str) -> str:
    """The first variant whose simulator, truth and noise are those of the variant's target.

    Raises InvalidInput if there is none.
    """
    hidden = variant_of(task, variant).hidden
    for name, other in variants_of(task).items():
        if other.source == hidden.source and _is_same_target(other.hidden, hidden):
            return name
    raise InvalidInput(
        f"no variant of {task} has the simulator of the target of {variant!r}, with its noise"
    )


def _is_same_target(one: Hidden, other: Hidden) -> bool:
    same_noise = one.noise_variance == other.noise_variance
    return same_noise and np.array_equal(one.values, other.values)


def source_of(task: str, domain: str) -> Source:
    """The simulator that methods may use: the variant's source with the domain's effects."""
    variant, effects = parse_domain(domain)
    return replace(variant_of(task, variant).source, effects=effects)


def hidden_of(task: str, domain: str) -> Hidden:
    """The truth behind a variant's target with the domain's effects.

    For simulated targets and environments alone.
    """
    variant, effects = parse_domain(domain)
    hidden = variant_of(task, variant).hidden
    return replace(hidden, source=replace(hidden.source, effects=effects))


def task_inputs(task: str) -> Mapping[str, str]:
    """A task's name, and its package with the version if it is not ours, for a stage's inputs.

    A change of one of our own tasks bumps the versions of the stage kinds instead.
    """
    package = package_of(TASKS, task)
    return {"task": task} if package is None else {"task": task, "package": package}


def _entry(task: str) -> Entry:
    if task not in catalogue():
        raise UnknownName("task", task, catalogue())
    return catalogue()[task]

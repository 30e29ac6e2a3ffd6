"""The tasks by name, with their variants and so with the truth that targets hide."""

from collections.abc import Mapping

from adr_service.errors import UnknownName
from adr_service.tasks import arm, half_cheetah, hopper, humanoid, walker2d
from adr_service.tasks.base import Hidden, Source, Task, Variant

_CATALOGUE: tuple[tuple[Task, Mapping[str, Variant]], ...] = (
    (arm.Arm(), arm.variants()),
    (hopper.Hopper(), hopper.variants()),
    (half_cheetah.HalfCheetah(), half_cheetah.variants()),
    (walker2d.Walker2d(), walker2d.variants()),
    (humanoid.Humanoid(), humanoid.variants()),
)
TASKS: Mapping[str, Task] = {task.name: task for task, _ in _CATALOGUE}
VARIANTS: Mapping[str, Mapping[str, Variant]] = {task.name: v for task, v in _CATALOGUE}


def get_task(name: str) -> Task:
    if name not in TASKS:
        raise UnknownName("task", name, TASKS)
    return TASKS[name]


def source_of(task: str, variant: str) -> Source:
    """What methods may simulate of a task's variant."""
    return _variant(task, variant).source


def hidden_of(task: str, variant: str) -> Hidden:
    """The truth behind a variant's simulated target. For `adr_service.target` alone."""
    return _variant(task, variant).hidden


def _variant(task: str, variant: str) -> Variant:
    get_task(task)
    if variant not in VARIANTS[task]:
        raise UnknownName(f"variant of {task}", variant, VARIANTS[task])
    return VARIANTS[task][variant]

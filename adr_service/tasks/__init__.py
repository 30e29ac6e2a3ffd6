"""The catalogue of tasks, by name."""

from collections.abc import Mapping

from adr_service.errors import UnknownName
from adr_service.tasks.arm import Arm
from adr_service.tasks.base import Hidden, Source, State, Task, Variant, variant_of
from adr_service.tasks.hopper import Hopper

_ALL: tuple[Task, ...] = (Arm(), Hopper())
TASKS: Mapping[str, Task] = {task.name: task for task in _ALL}


def get_task(name: str) -> Task:
    if name not in TASKS:
        raise UnknownName("task", name, TASKS)
    return TASKS[name]


__all__ = ["TASKS", "Hidden", "Source", "State", "Task", "Variant", "get_task", "variant_of"]

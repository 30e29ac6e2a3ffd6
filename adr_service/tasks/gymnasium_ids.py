"""The ids of our tasks in Gymnasium: `adr/RandomHopper-v0`, `adr/RandomHopperNoisy-v0` and so on.

`import adr_service` registers them with Gymnasium, whichever is imported first. Gymnasium 1.0
dropped the entry points by which it looked for environments, and importing it takes a tenth of a
second, so we wait until somebody else does.
"""

import importlib.util
import sys
import threading
from collections.abc import Sequence
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from types import ModuleType

from adr_service.errors import UnknownName

_GYMNASIUM = "gymnasium"


def gymnasium_id(task: str, variant: str) -> str:
    """The id of a built-in task's variant. Raises UnknownName for others, which have none."""
    from adr_service.tasks.catalogue import BUILT_IN

    if task not in BUILT_IN:
        raise UnknownName("task with a Gymnasium id", task, BUILT_IN)
    if variant not in BUILT_IN[task].variants:
        raise UnknownName("variant with a Gymnasium id", variant, BUILT_IN[task].variants)
    robot = "".join(word.capitalize() for word in task.split("_"))
    suffix = "" if variant == "vanilla" else variant.capitalize()
    return f"adr/Random{robot}{suffix}-v0"


def register_with_gymnasium() -> None:
    """Register our ids now if Gymnasium has been imported, else when it is."""
    if _GYMNASIUM in sys.modules:
        _register()
    else:
        sys.meta_path.insert(0, _AfterGymnasium())


class _AfterGymnasium:
    """A finder on `sys.meta_path` that registers our ids after the import of Gymnasium.

    Others may look Gymnasium up without importing it, so it stays until an import has run.
    """

    def __init__(self) -> None:
        self._looking = threading.local()  # a look-up by this finder itself must pass it by

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _GYMNASIUM or getattr(self._looking, "now", False):
            return None
        self._looking.now = True
        try:
            spec = importlib.util.find_spec(fullname)
        finally:
            self._looking.now = False
        if spec is not None and spec.loader is not None:
            self._register_after(spec.loader)
        return spec

    def _register_after(self, loader: Loader) -> None:
        """Let a loader register our ids after it has executed its module."""
        execute = loader.exec_module

        def execute_and_register(module: ModuleType) -> None:
            execute(module)
            sys.meta_path.remove(self)
            _register()

        loader.exec_module = execute_and_register


def _register() -> None:
    import gymnasium

    from adr_service.tasks.catalogue import BUILT_IN

    for name, entry in BUILT_IN.items():
        for variant in entry.variants:
            gymnasium.register(
                id=gymnasium_id(name, variant),
                entry_point="adr_service.simulation.gym_env:RandomizedEnv",
                max_episode_steps=entry.task.horizon,
                kwargs={"task": name, "variant": variant},
            )

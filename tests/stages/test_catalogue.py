"""All kinds of stages, with their versions."""

import importlib
import inspect
import pkgutil

from adr_service import stages
from adr_service.stages.base import Stage
from adr_service.stages.catalogue import VERSIONS


def test_every_kind_is_listed_with_its_version():
    modules = [
        importlib.import_module(m.name)
        for m in pkgutil.iter_modules(stages.__path__, "adr_service.stages.")
    ]
    classes = {
        member
        for module in modules
        for _, member in inspect.getmembers(module, inspect.isclass)
        if issubclass(member, Stage) and not inspect.isabstract(member)
    }
    assert {each.kind: each.version for each in classes} == VERSIONS
    assert len(classes) == len(VERSIONS) == 9

"""The catalogue of methods: the settings class of each is its entry.

Ours, and those of installed packages: an entry point of the group `adr_service.methods` names a
settings class (docs/add-a-method.md).
"""

import inspect
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args

from pydantic import Field, TypeAdapter

from adr_service.errors import InvalidInput
from adr_service.methods.base import MethodSettings, OfflineSettings, OnlineSettings
from adr_service.methods.bayrn import BayRnSettings
from adr_service.methods.droid import DroidSettings
from adr_service.methods.dropo import DropoSettings
from adr_service.methods.references import OracleSettings, PriorSettings
from adr_service.methods.simopt import SimOpt1Settings, SimOptSettings
from adr_service.methods.sysid import SysidSettings
from adr_service.methods.udr import UdrSettings
from adr_service.plugins import installed, load, origin, package_of

GROUP = "adr_service.methods"
BUILT_IN: tuple[type[MethodSettings], ...] = (
    UdrSettings,
    BayRnSettings,
    SimOptSettings,
    SimOpt1Settings,
    DroidSettings,
    DropoSettings,
    SysidSettings,
)
REFERENCES: tuple[type[MethodSettings], ...] = (PriorSettings, OracleSettings)


@cache
def methods() -> Mapping[str, type[MethodSettings]]:
    """The settings classes by the methods' names: ours, installed packages', the references."""
    references = {_name(settings): settings for settings in REFERENCES}
    entries = {_name(settings): settings for settings in BUILT_IN}
    for point in installed(GROUP):
        settings = load(point)
        if not (isinstance(settings, type) and issubclass(settings, _INFERRING)):
            raise InvalidInput(
                f"{origin(point)} must name a subclass of OfflineSettings or OnlineSettings "
                f"(adr_service.methods.base); it is {settings!r}"
            )
        if inspect.isabstract(settings):
            lacking = ", ".join(sorted(settings.__abstractmethods__))
            raise InvalidInput(f"{origin(point)} gives {settings.__name__}, which lacks {lacking}")
        if _name(settings) != point.name:
            raise InvalidInput(
                f"{origin(point)} gives a method of another name, {_name(settings)!r}"
            )
        if point.name in entries | references:
            raise InvalidInput(f"{origin(point)} gives a method which there is already")
        entries[point.name] = settings
    return entries | references


def parse_settings(document: Any) -> MethodSettings:
    """The settings of any method, from JSON."""
    return TypeAdapter[MethodSettings](AnyMethod).validate_python(document)


def identity_of(settings: MethodSettings) -> dict[str, Any]:
    """What a stage's inputs say of a method: its settings, and a foreign package's version."""
    document = settings.model_dump()
    package = package_of(GROUP, settings.name)
    return {"method": document} | ({} if package is None else {"method_package": package})


def is_inferring(settings: MethodSettings) -> bool:
    """Whether the method infers one distribution, from what the target shows."""
    return isinstance(settings, _INFERRING)


def _name(settings: type[MethodSettings]) -> str:
    """The method's name, the only value of the literal; empty where there is none."""
    return str(next(iter(get_args(settings.model_fields["name"].annotation)), ""))


_INFERRING = (OfflineSettings, OnlineSettings)

if TYPE_CHECKING:
    AnyMethod = MethodSettings
else:  # the tagged union of what is installed: its JSON schema lists them all
    AnyMethod = Annotated[Union[tuple(methods().values())], Field(discriminator="name")]  # noqa: UP007

"""The catalogue of methods, in which each method's settings class is its entry.

It collects the settings classes in the modules of this package, and those that installed packages
name by an entry point of the group `adr_service.methods` (docs/add-a-method.md).
"""

import inspect
import pkgutil
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args

from pydantic import Field, ValidationError
from pydantic_core import PydanticSerializationError

import adr_service.methods
from adr_service.errors import InvalidInput
from adr_service.json_values import message_of
from adr_service.methods.base import (
    CurriculumSettings,
    Data,
    MethodSettings,
    OfflineSettings,
    OnlineSettings,
    ReturnsSettings,
)
from adr_service.plugins import METHODS, installed, load, origin, package_of

_ORDER: tuple[Data, ...] = get_args(Data)


@cache
def methods() -> Mapping[str, type[MethodSettings]]:
    """Settings classes by method name: ours, then those of installed packages, then references.

    Ours stand in the order of the data they learn from: nothing, returns, visits, recordings.
    """
    ours = {name_of(settings): settings for settings in sorted(_built_in(), key=_rank)}
    references = {name: each for name, each in ours.items() if each.is_reference}
    entries = {name: each for name, each in ours.items() if not each.is_reference}
    for point in installed(METHODS):
        settings = _settings_at(point)
        if point.name in entries | references:
            raise InvalidInput(
                f"{origin(point)} gives a method whose name is taken; the other methods are "
                f"{', '.join(entries | references)}"
            )
        entries[point.name] = settings
    return entries | references


def names_of(learns_from: Data) -> list[str]:
    """Names of the methods that learn from one kind of data."""
    return [name for name, each in methods().items() if each.learns_from == learns_from]


def check_installed(name: str) -> None:
    """Raise InvalidInput for a method whose extra is not installed here."""
    extra = methods()[name].extra
    if extra and find_spec(extra) is None:
        raise InvalidInput(f"{name} needs {extra}: pip install 'adr-service[{extra}]'")


def method_inputs(settings: MethodSettings) -> dict[str, Any]:
    """Inputs by which a stage knows a method: its settings, and the version of its package."""
    return {"method": settings, "method_package": package_of(METHODS, settings.name)}


def name_of(settings: type[MethodSettings]) -> str:
    """Name of the method, from the literal type of the field; empty if there is none."""
    return str(next(iter(get_args(settings.model_fields["name"].annotation)), ""))


def _settings_at(point: EntryPoint) -> type[MethodSettings]:
    """The settings class that an entry point names, if it is complete and has the point's name."""
    settings = load(point)
    if not (isinstance(settings, type) and issubclass(settings, _OPEN)):
        raise InvalidInput(
            f"{origin(point)} must name a subclass of OfflineSettings, OnlineSettings, "
            f"ReturnsSettings or CurriculumSettings (adr_service.methods.base); it is {settings!r}"
        )
    if inspect.isabstract(settings):
        lacking = ", ".join(sorted(settings.__abstractmethods__))
        raise InvalidInput(f"{origin(point)} gives {settings.__name__}, which lacks {lacking}")
    if name_of(settings) != point.name:
        raise InvalidInput(f"{origin(point)} gives a method of another name, {name_of(settings)!r}")
    _check_defaults(point, settings)
    return settings


def _check_defaults(point: EntryPoint, settings: type[MethodSettings]) -> None:
    """Raise InvalidInput unless the settings can be read from the JSON of their defaults.

    Runs are kept with their settings as JSON. A field without a default cannot be tried, nor what a
    validator says of several fields.
    """
    defaults, whose = settings.model_construct(), f"{origin(point)} gives {settings.__name__}"
    try:
        settings.model_validate(defaults.model_dump(mode="json", warnings=False))
    except PydanticSerializationError as error:
        raise InvalidInput(f"{whose}, whose defaults are not JSON: {error}") from error
    except ValidationError as error:
        faults = [f for f in error.errors() if f["loc"] and f["type"] != "missing"]
        if faults:
            fields = "; ".join(f"{'.'.join(map(str, f['loc']))}: {message_of(f)}" for f in faults)
            raise InvalidInput(
                f"{whose}, whose defaults cannot be read from their JSON: {fields}"
            ) from error


def _built_in() -> Iterator[type[MethodSettings]]:
    """Settings classes in the modules of this package, by module, in the order of definition."""
    for module in pkgutil.iter_modules(adr_service.methods.__path__):
        if module.name not in ("base", "catalogue"):
            content = vars(import_module(f"{adr_service.methods.__name__}.{module.name}"))
            classes = (value for value in content.values() if isinstance(value, type))
            yield from (c for c in classes if issubclass(c, MethodSettings) and name_of(c))


def _rank(settings: type[MethodSettings]) -> int:
    return _ORDER.index(settings.learns_from)


# what installed packages may bring
_OPEN = (OfflineSettings, OnlineSettings, ReturnsSettings, CurriculumSettings)

if TYPE_CHECKING:
    AnyMethod = MethodSettings
else:  # the tagged union of what is installed: its JSON schema lists them all
    AnyMethod = Annotated[Union[tuple(methods().values())], Field(discriminator="name")]  # noqa: UP007 - the tuple is computed

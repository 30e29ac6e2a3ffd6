"""Names in specs, which must be those of something that exists."""

from collections.abc import Iterable
from typing import Annotated, Any, Literal, cast

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PlainSerializer,
    Tag,
    ValidationInfo,
)

from adr_service.errors import UnknownName
from adr_service.json_values import Wire
from adr_service.methods.catalogue import AnyMethod, methods
from adr_service.presets import PRESETS
from adr_service.tasks.catalogue import catalogue, variant_of

Collector = Literal["simopt", "prior", "random", "random_matched"]


def _known(kind: str, name: str, accepted: Iterable[str]) -> str:
    if name not in accepted:
        raise ValueError(str(UnknownName(kind, name, accepted)))
    return name


def _known_variant(name: str, info: ValidationInfo) -> str:
    """A variant of the task, or of all tasks; wrong tasks have errors of their own."""
    for task in info.data.get("tasks", [info.data["task"]] if "task" in info.data else []):
        try:
            variant_of(task, name)
        except UnknownName as error:
            raise ValueError(str(error)) from error
    return name


def known_method(given: Any) -> Any:
    """A method's name, or its settings as JSON with `name`, which a dump of given fields keeps.

    Refuses a method that is not installed, and says which one may be meant.
    """
    given = as_given(given)
    name = cast(dict[str, Any], given).get("name") if isinstance(given, dict) else given
    if not isinstance(name, str):
        raise ValueError(
            f"give a method's name, or its settings with `name`; accepted: {', '.join(methods())}"
        )
    try:
        _known("method", name, methods())
    except ValueError as error:
        raise ValueError(
            f"{error} (one just installed counts once `adr serve` starts anew)"
        ) from error
    return given


# pydantic refuses half characters (lone surrogates) where a text has a length
Name = Annotated[str, Field(max_length=1000)]
TaskName = Annotated[
    Name,
    AfterValidator(lambda name: _known("task", name, catalogue())),
    Field(description="arm, hopper, half_cheetah, walker2d, humanoid, or a task of your own"),
]
VariantName = Annotated[
    Name,
    AfterValidator(_known_variant),
    Field(
        description="vanilla, noisy (sensors' noise), unmodeled (wrong frozen parameters), edge or "
        "outside (the truth at the end of the search bounds, or beyond it)"
    ),
]
PresetName = Annotated[
    Name,
    AfterValidator(lambda name: _known("preset", name, PRESETS)),
    Field(description="what fills the fields that are not given"),
]
Seed = Annotated[int, Field(ge=0, lt=2**31, description="seed of every random draw")]
Resolution = Annotated[float, Field(gt=0, le=1)]  # of beliefs, in [0, 4] coordinates
NameOrSettings = Annotated[
    Annotated[Name, Tag("name")] | Annotated[AnyMethod, Tag("settings")],
    Discriminator(lambda given: "name" if isinstance(given, str) else "settings"),
    BeforeValidator(known_method),
    # the preset fills what is not given: defaults in its place would be another benchmark
    PlainSerializer(lambda method: as_given(method)),  # noqa: PLW0108 - it keeps the schema
    # no name is settings too, which fuzzers cannot see behind "oneOf"
    Field(json_schema_extra=lambda schema: schema.update(anyOf=schema.pop("oneOf"))),
]


def as_given(value: Any) -> Any:
    """The given fields of one of our values, and its tag, as JSON; other values as they are."""
    if not isinstance(value, Wire):
        return value
    tags = [tag for tag in ("name", "kind", "algorithm") if tag in type(value).model_fields]
    return {tag: getattr(value, tag) for tag in tags} | value.model_dump(exclude_unset=True)

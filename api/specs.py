"""Specs from files, and from settings as text."""

import json
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from adr_service.errors import InvalidInput


def read_spec(file: Path) -> dict[str, Any]:
    """Return the JSON object in a file."""
    try:
        spec = json.loads(file.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise InvalidInput(f"{file} is not a readable JSON file: {error}") from error
    if not isinstance(spec, dict):
        raise InvalidInput(f"{file} must hold one JSON object; given {type(spec).__name__}")
    return spec


def read_effects(file: Path) -> list[dict[str, Any]]:
    """Return the effects in `effects.json` of a criticism, as a spec's `extension` takes them."""
    return effects_of(read_spec(file), str(file))


def effects_of(content: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """Return the effects in the content of an `effects.json`; errors call it `name`."""
    effects: Any = content.get("effects")
    version = content.get("version")
    is_list = isinstance(effects, list) and all(isinstance(each, dict) for each in effects)
    if version != 1 or not is_list:
        raise InvalidInput(
            f"{name} is no list of effects, version 1; give effects.json of `adr criticise`"
        )
    return [{k: v for k, v in effect.items() if k != "in_mjcf"} for effect in effects]


def assign(
    spec: dict[str, Any], assignments: Iterable[str] | None, fixed: Collection[str] = ()
) -> None:
    """Set fields of a spec from texts `a.b=value`; a value is JSON, or else text.

    Raises InvalidInput for a path that is set twice, holds one that was set before or lies in one,
    or is `fixed`.
    """
    assigned: set[str] = set()
    for assignment in assignments or ():
        path, text = _split(assignment)
        holds = any(f"{known}.".startswith(f"{path}.") for known in (*fixed, *assigned))
        if holds or any(f"{path}.".startswith(f"{known}.") for known in assigned):
            raise InvalidInput(f"{path} is given already, and {assignment!r} beside it; give one")
        assigned.add(path)
        _set(spec, path.split("."), read_value(text))


def named_values(assignments: Iterable[str] | None) -> dict[str, Any]:
    """Values by name from texts `name=value`, where a name may have dots; a value is JSON, or else
    text. Raises InvalidInput for a name that is given twice."""
    values: dict[str, Any] = {}
    for assignment in assignments or ():
        name, text = _split(assignment)
        if name in values:
            raise InvalidInput(f"{name} is given already, and {assignment!r} beside it; give one")
        values[name] = read_value(text)
    return values


def _split(assignment: str) -> tuple[str, str]:
    name, equals, text = assignment.partition("=")
    if not equals:
        raise InvalidInput(f"a setting is name=value, as iterations=2; given {assignment!r}")
    return name, text


def read_value(text: str) -> Any:
    """A value that is JSON, or else text."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _set(spec: dict[str, Any], path: list[str], value: Any) -> None:
    *parents, last = path
    inner = spec
    for number, name in enumerate(parents, 1):
        if inner.get(name) is None:
            inner[name] = {}
        # a method given by name becomes an object when one of its settings is set
        elif name == "method" and isinstance(inner[name], str):
            inner[name] = {"name": inner[name]}
        elif not isinstance(inner[name], dict):
            place, given = ".".join(parents[:number]), json.dumps(inner[name])
            raise InvalidInput(
                f"{'.'.join(path)} cannot be set: {place} is {given}; set it whole, in JSON"
            )
        inner = inner[name]
    inner[last] = value

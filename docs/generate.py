"""Write the pages of docs/reference that say what the code says: `python docs/generate.py`."""

import inspect
import json
import math
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from typer import Context
from typer.core import TyperGroup
from typer.main import get_command

from adr_service.effects.base import Strength
from adr_service.effects.catalogue import MECHANISMS
from adr_service.errors import FailureCode
from adr_service.methods.base import MethodSettings
from adr_service.methods.catalogue import methods
from adr_service.presets import PRESETS
from adr_service.specs import BenchmarkExtension, BenchmarkSpec, CriticismSpec, RunSpec
from api.app import create_app
from api.cli import app
from api.settings import Settings

Json = dict[str, Any]
FOLDER = Path(__file__).parent / "reference"
_BOUNDS = {
    "minimum": "≥ {}",
    "exclusiveMinimum": "> {}",
    "maximum": "≤ {}",
    "exclusiveMaximum": "< {}",
    "minItems": "{} or more",
    "maxItems": "{} at most",
}
_SPECS = (RunSpec, BenchmarkSpec, BenchmarkExtension, CriticismSpec)
_GENERATED = "<!-- written by docs/generate.py -->\n"


def pages() -> dict[str, str]:
    """Return the text of each page by its file's name."""
    return {
        "methods.md": methods_page(),
        "effects.md": effects_page(),
        "specs.md": specs_page(),
        "rest.md": rest_page(create_app(Settings.model_construct()).openapi()),
        "command-line.md": command_line_page(),
    }


def methods_page() -> str:
    """Every method with its data, its settings and the docstring of its module."""
    known = methods()
    rows = (
        (f"`{name}`", _learns(each), f"[{each.__name__}](specs.md#{each.__name__.lower()})")
        for name, each in known.items()
    )
    lines = [
        "# Methods",
        _GENERATED,
        "How well each finds the truth on every task is measured in "
        "[recovery of the truth](../recovery.md).",
        _table(("method", "learns from", "settings"), rows),
    ]
    for module in dict.fromkeys(each.__module__ for each in known.values()):
        names = ", ".join(f"`{name}`" for name, each in known.items() if each.__module__ == module)
        text = inspect.cleandoc(sys.modules[module].__doc__ or "")
        # a list needs an empty line before it, here but not on GitHub
        lines += [f"## {names}", re.sub(r"(:\n)(?=- )", r"\1\n", text)]
    return "\n\n".join(lines) + "\n"


def _learns(method: type[MethodSettings]) -> str:
    if method.is_reference:
        return "the hidden truth" if method.needs_truth else "nothing"
    kinds = {
        "nothing": "nothing",
        "returns": "returns of its own policies on the target",
        "visits": "visits of its own policies to the target (online)",
        "recordings": "recorded transitions (offline)",
    }
    return kinds[method.learns_from]


def effects_page() -> str:
    """Every kind of effect, with its places and its strengths."""
    rows = (
        (
            f"`{kind}`",
            f"`{each.place}`" if each.place == "global" else f"`{each.place}:NAME`",
            "; ".join(map(_strength, each.strengths)),
        )
        for kind, each in MECHANISMS.items()
    )
    lines = [
        "# Effects",
        _GENERATED,
        "What an `extension` and a simulated target's `effects` are made of, as "
        '`{"kind": "joint_coulomb_friction", "location": "joint:elbow", "values": [0.2]}`: '
        "`values` has the strengths in this order; all zero, nothing changes. A sensor is a "
        "measured column, as `sensor:elbow.position`. Units are those at a hinge; at a slide, m "
        "stands for rad.",
        _table(("kind", "location", "strengths"), rows),
    ]
    return "\n\n".join(lines) + "\n"


def _strength(strength: Strength) -> str:
    least = "" if strength.low == -math.inf else f", {strength.low:g} at least"
    return f"{strength.name} [{strength.unit}]{least}"


def specs_page() -> str:
    """Every field of what can be submitted, and every object within them."""
    lines = [
        "# Specs",
        _GENERATED,
        "What a run, a benchmark and a criticism are made of. A field without a default must be "
        "given, but for those that the [preset](#presets) gives; what you give wins over the "
        "preset, field by field. Anything else is refused, with what is accepted.",
    ]
    definitions: dict[str, Json] = {}
    for model in _SPECS:
        schema = model.model_json_schema()
        definitions |= schema.pop("$defs", {})
        lines += [f"## {model.__name__}", *_about(schema), *_fields(schema)]
    lines += ["## Presets", *_presets()]
    for name, schema in sorted(definitions.items()):
        if name not in {model.__name__ for model in _SPECS}:
            lines += [f"## {name}", *_about(schema), *_fields(schema)]
    return _as_written("\n\n".join(lines), definitions)


def _presets() -> Iterator[str]:
    for name, preset in PRESETS.items():
        yield f"### `{name}`"
        yield "\n".join(["```json", json.dumps(preset, indent=1), "```"])


def rest_page(api: Json) -> str:
    """Every route with its parameters, body and answer, and every object that they have."""
    schemas = api["components"]["schemas"]
    lines = [
        "# REST",
        _GENERATED,
        "The service describes itself as OpenAPI at `/openapi.json`, and as a page at `/docs`. "
        "Bodies are JSON but for uploads, which are bytes. With `ADR_TOKEN` set, requests carry it "
        "in the header `Authorization: Bearer TOKEN`.",
        "## Errors",
        "A refusal has the media type `application/problem+json` (RFC 9457): `type`, `title`, "
        "`status`, `detail`, and `errors` with `pointer`, `detail` and `given` for each invalid "
        "field. A run that fails has one of these codes in its `error`:",
        _table(
            ("code", "meaning", "remedy"),
            ((f"`{code}`", code.meaning, code.remedy) for code in FailureCode),
        ),
    ]
    for path, routes in sorted(api["paths"].items()):
        for method, about in routes.items():
            lines += [f"## `{method.upper()} {path}`", *_route(about)]
    for name, schema in sorted(schemas.items()):
        lines += [f"## {name}", *_about(schema), *_fields(schema)]
    return _as_written("\n\n".join(lines), schemas)


def _as_written(page: str, schemas: Json) -> str:
    """A page whose choices between objects show the value that tells one from another: `simopt_1`
    rather than the name of its class."""
    for name, schema in schemas.items():
        values = [
            each["const"] for each in schema.get("properties", {}).values() if "const" in each
        ]
        if len(values) == 1:
            link = re.escape(f"[{name}](") + r"(#[^)]*\))"
            for choice in (rf"(?<= or ){link}", rf"{link}(?= or )"):
                page = re.sub(choice, rf"[`{values[0]}`](\1", page)
    return page + "\n"


def _route(about: Json) -> Iterator[str]:
    yield about["description"]
    if parameters := about.get("parameters"):
        cells = (
            (f"`{p['name']}`", p["in"], *_cells(p["schema"], p["required"])) for p in parameters
        )
        yield _table(("parameter", "in", "accepted", "default", "meaning"), cells)
    for media, given in about.get("requestBody", {}).get("content", {}).items():
        yield f"Body, `{media}`: {_type(given.get('schema', {}))}."
    for status, answer in about["responses"].items():
        found = [_type(each.get("schema", {})) for each in answer.get("content", {}).values()]
        if status != "default":
            yield f"Answer {status}: {', '.join(found) or 'no JSON'}."


def _about(schema: Json) -> Iterator[str]:
    if text := schema.get("description", ""):
        yield " ".join(text.split())


def _fields(schema: Json) -> Iterator[str]:
    if "enum" in schema:
        yield f"One of {_type(schema)}."
    elif properties := schema.get("properties"):
        required = schema.get("required", ())
        cells = ((f"`{k}`", *_cells(v, k in required)) for k, v in properties.items())
        yield _table(("field", "accepted", "default", "meaning"), cells)


def _cells(schema: Json, is_required: bool) -> tuple[str, str, str]:
    """The accepted values, the default and the meaning of a field."""
    has_default = not is_required and "default" in schema
    default = f"`{json.dumps(schema['default'])}`" if has_default else ""
    return _type(schema), default, _meaning(schema)


def _meaning(schema: Json) -> str:
    """The description of a field, or of the choice that has one."""
    choices = (each.get("description", "") for each in (schema, *schema.get("anyOf", ())))
    return next(filter(None, choices), "")


def _type(schema: Json) -> str:
    """The values that a schema accepts; objects are links to their sections."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return ", ".join(f"`{json.dumps(each)}`" for each in schema["enum"])
    if choices := schema.get("oneOf") or schema.get("anyOf") or schema.get("allOf"):
        return " or ".join(dict.fromkeys(_type(each) for each in choices))
    name = schema.get("type", "any JSON")
    if name == "array":
        name = f"list of {_type(schema.get('items', {}))}"
    bounds = [text.format(schema[key]) for key, text in _BOUNDS.items() if key in schema]
    return ", ".join([name, *bounds])


def command_line_page() -> str:
    """The help of every command."""
    lines = ["# Command line", _GENERATED.rstrip(), *_help(Context(get_command(app)), "adr")]
    return "\n\n".join(lines) + "\n"


def _help(context: Context, path: str) -> Iterator[str]:
    """A command's help, usage and parameters, then all of the commands below it."""
    command = context.command
    yield command.help or ""
    usage = " ".join([path, *command.collect_usage_pieces(context)])
    yield f"**Usage**:\n\n```console\n$ {usage}\n```"
    for heading, kind in (("Arguments", "argument"), ("Options", "option")):
        parameters = [p for p in command.get_params(context) if p.param_type_name == kind]
        records = [p.get_help_record(context) for p in parameters]
        yield from _list(heading, [record for record in records if record is not None])
    if command.epilog:
        yield command.epilog
    below = command.commands if isinstance(command, TyperGroup) else {}
    firsts = [(name, (each.help or "").partition("\n\n")[0]) for name, each in below.items()]
    yield from _list("Commands", firsts)
    for name, each in below.items():
        yield f"{'#' * (len(path.split()) + 1)} `{path} {name}`"
        yield from _help(Context(each, parent=context), f"{path} {name}")


def _list(heading: str, entries: Sequence[tuple[str, str]]) -> Iterator[str]:
    if entries:
        lines = (f"* `{name}`: {text}" if text else f"* `{name}`" for name, text in entries)
        yield "\n".join([f"**{heading}**:\n", *lines])


def _table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    headings = list(headings)
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join(f"| {' | '.join(_cell(cell) for cell in line)} |" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


if __name__ == "__main__":
    for name, text in pages().items():
        (FOLDER / name).write_text(text)

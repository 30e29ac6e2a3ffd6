"""JSON values that cross the network or enter a digest: frozen, strict and finite."""

import hashlib
import json
import re
from collections.abc import Collection
from typing import Annotated, Any, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from adr_service.errors import UnknownName

_UNKNOWN_FIELD = "unknown_field"  # type of an error
# characters that move a terminal's cursor, end lines or turn the direction of writing
_CONTROL = r"\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069"
_NOT_IN_A_LINE = re.compile(rf"[{_CONTROL}\t\n]")
_NOT_IN_TEXT = re.compile(rf"[{_CONTROL}]")
_LINE, _PARAGRAPHS = rf"^[^{_CONTROL}\t\n]*$", rf"^[^{_CONTROL}]*$"
_OF_PATTERNS = {  # what they ask for
    _LINE: "expected is one line of text without control characters",
    _PARAGRAPHS: "expected is text without control characters",
}
# texts of users, which appear in logs and on terminals
Line = Annotated[str, Field(pattern=_LINE)]
Paragraphs = Annotated[str, Field(pattern=_PARAGRAPHS)]


def is_a_line(text: str) -> bool:
    """True if the text has no line ends or other control characters."""
    return not _NOT_IN_A_LINE.search(text)


def printable(text: str) -> str:
    """The text with control characters escaped, except line ends and tabs."""
    return _NOT_IN_TEXT.sub(lambda match: ascii(match[0])[1:-1], text)


def encodable(text: str) -> str:
    """The text with halves of letters, as names of files may have, escaped: UTF-8 has none."""
    return text.encode("utf-8", "backslashreplace").decode()


class Wire(BaseModel):
    """A value with a JSON form that refuses unknown fields, wrong types, NaN and infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _known_fields(cls, given: Any) -> Any:
        return refuse_unknown_fields(given, cls.model_fields)


def refuse_unknown_fields(given: Any, fields: Collection[str]) -> Any:
    """The value as it is; raises ValidationError at the first unknown field of a JSON object.

    Pydantic refuses unknown fields too, but does not list the known ones.
    """
    if isinstance(given, dict):
        for name, value in cast(dict[Any, Any], given).items():
            if name not in fields:
                detail = str(UnknownName("field", str(name), fields))
                kind = PydanticCustomError(_UNKNOWN_FIELD, "{detail}", {"detail": detail})
                error = InitErrorDetails(type=kind, loc=(str(name),), input=value)
                raise ValidationError.from_exception_data("unknown field", [error])
    return given


def canonical_json(value: Any) -> str:
    """The canonical text of a JSON value: sorted keys, no spaces, shortest exact floats."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def explain(error: ValidationError, whole: str) -> str:
    """All errors of a validation with their places, in one line.

    `whole` names the place of an error that concerns no single field.
    """
    return "; ".join(f"{_place(e) or whole}: {message_of(e)}" for e in error.errors())


def message_of(error: ErrorDetails) -> str:
    """The reason of an error; Pydantic shows patterns as they are."""
    pattern = error.get("ctx", {}).get("pattern", "")
    return _OF_PATTERNS.get(pattern, error["msg"].removeprefix("Value error, "))


def _place(error: ErrorDetails) -> str:
    """The place of an error; of an unknown field, which the message names, that of its object."""
    place = error["loc"][:-1] if error["type"] == _UNKNOWN_FIELD else error["loc"]
    return ".".join(map(str, place))

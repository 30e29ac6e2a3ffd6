"""The base of everything that crosses the network or enters a digest: frozen, strict, finite."""

import hashlib
import json
from typing import Any, cast

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from adr_service.errors import UnknownName


class Wire(BaseModel):
    """A value with a JSON form; unknown fields, wrong types, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _known_fields(cls, given: Any) -> Any:
        """Pydantic refuses unknown fields too, but does not say which there are."""
        if isinstance(given, dict):
            for name in cast(dict[Any, Any], given):
                if name not in cls.model_fields:
                    raise ValueError(str(UnknownName("field", str(name), cls.model_fields)))
        return given


def canonical_json(value: Any) -> str:
    """The one text of a JSON value: sorted keys, no spaces, shortest exact floats."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def explain(error: ValidationError, whole: str) -> str:
    """What is wrong where, in a line; `whole` names what has no field of its own."""
    told = "; ".join(f"{'.'.join(map(str, e['loc'])) or whole}: {e['msg']}" for e in error.errors())
    return told.replace("Value error, ", "")

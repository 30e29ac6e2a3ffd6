"""The base of everything that crosses the network or enters a digest: frozen, strict, finite."""

import hashlib
import json
from typing import Any

from pydantic import BaseModel, ConfigDict


class Wire(BaseModel):
    """A value with a JSON form; unknown fields, wrong types, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def canonical_json(value: Any) -> str:
    """The one text of a JSON value: sorted keys, no spaces, shortest exact floats."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()

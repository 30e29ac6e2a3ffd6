"""The two references of every benchmark: they infer nothing.

`prior` trains on the conservative start of all methods (iteration 0), `oracle` on the hidden
truth, which the target reveals to nobody else. Lower and upper reference.
"""

from typing import Literal

from adr_service.methods.base import MethodSettings


class PriorSettings(MethodSettings):
    name: Literal["prior"] = "prior"


class OracleSettings(MethodSettings):
    name: Literal["oracle"] = "oracle"

"""The two references of every benchmark: they infer nothing.

`prior` trains on the conservative start of all methods (iteration 0), `oracle` on the hidden
truth, which the target reveals to nobody else. Lower and upper reference.
"""

from typing import Literal

from adr_service.wire import Wire


class PriorSettings(Wire):
    name: Literal["prior"] = "prior"


class OracleSettings(Wire):
    name: Literal["oracle"] = "oracle"

"""The two references of every benchmark, which infer nothing.

`prior` trains on the conservative start of all methods (iteration 0), `oracle` on the hidden
truth, which the target reveals to nobody else. Lower and upper reference.
"""

from typing import ClassVar, Literal

from adr_service.methods.base import Data, MethodSettings


class PriorSettings(MethodSettings):
    """The policy that is trained on the prior."""

    name: Literal["prior"] = "prior"

    program: ClassVar[str] = "adr_service.programs.references"
    learns_from: ClassVar[Data] = "nothing"
    believes: ClassVar[bool] = True
    is_reference: ClassVar[bool] = True
    is_level: ClassVar[bool] = True
    colour: ClassVar[str] = "#666666"


class OracleSettings(MethodSettings):
    """The policy that is trained on the hidden truth."""

    name: Literal["oracle"] = "oracle"

    program: ClassVar[str] = "adr_service.programs.references"
    learns_from: ClassVar[Data] = "nothing"
    needs_truth: ClassVar[bool] = True
    is_reference: ClassVar[bool] = True
    is_level: ClassVar[bool] = True
    colour: ClassVar[str] = "#009E73"

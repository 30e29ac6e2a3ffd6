"""The two references of every benchmark, which infer nothing.

`prior` trains on N(2, I), the conservative start of all methods (benchmark, Sec. 3.4); it is the
lower reference. `oracle` trains on the hidden truth, which no method may see; it is the upper one.
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
    colour: ClassVar[str] = "#666666"


class OracleSettings(MethodSettings):
    """The policy that is trained on the hidden truth."""

    name: Literal["oracle"] = "oracle"

    program: ClassVar[str] = "adr_service.programs.references"
    learns_from: ClassVar[Data] = "nothing"
    needs_truth: ClassVar[bool] = True
    is_reference: ClassVar[bool] = True
    colour: ClassVar[str] = "#009E73"

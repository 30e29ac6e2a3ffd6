# What we use of MuJoCo, which ships no types.
from typing import Any, Self

class MjModel:
    def __getattr__(self, name: str) -> Any: ...
    @classmethod
    def from_xml_string(cls, xml: str) -> Self: ...

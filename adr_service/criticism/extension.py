"""A simulator with what it lacked: MJCF, and a sidecar for what MJCF cannot say.

extension = extend(nominal, parameters, causes)
extension.xml          # compiles to the fitted model, to the last digit
extension.sidecar      # effects on commands and in sensors, replayed by this package
"""

import ctypes
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.causes import Cause
from adr_service.criticism.simulator import Nominal
from adr_service.parameters import ParameterSpace
from adr_service.simulation.mechanisms import get_mechanism, with_causes

_DIGITS = 17  # that tell every double apart


@dataclass(frozen=True)
class Extension:
    """An extended model, as two files have it."""

    xml: str
    causes: tuple[Cause, ...]  # those that are not in the MJCF

    @property
    def sidecar(self) -> dict[str, Any]:
        """JSON: the effects that the MJCF cannot say, in the order in which they act."""
        return {"version": 1, "effects": [asdict(cause) for cause in self.causes]}

    def nominal(self) -> Nominal:
        """The extended model as a simulator without free parameters."""
        return Nominal(self.xml, ParameterSpace(()), np.empty(0))


def extend(nominal: Nominal, parameters: Vector, causes: Sequence[Cause]) -> Extension:
    """The model with fitted parameters and causes, written out."""
    spec = nominal.spec(parameters)
    model = with_causes(spec, lambda model: nominal.write(model, parameters), causes)
    spec.copy_back(model)
    beside = [cause for cause in causes if get_mechanism(cause.kind).change is None]
    return Extension(written_out(spec), tuple(beside))


def written_out(spec: mujoco.MjSpec) -> str:
    """MJCF with all digits of all numbers."""
    with _all_digits():
        return spec.to_xml()


@contextmanager
def _all_digits() -> Generator[None]:
    """MuJoCo writes six digits; the function that changes it has no name in its Python module."""
    folder = Path(mujoco.__file__).parent
    library = ctypes.CDLL(str(next(folder.glob("libmujoco*"))))
    before = library._mjPRIVATE__get_xml_precision()
    library._mjPRIVATE__set_xml_precision(_DIGITS)
    try:
        yield
    finally:
        library._mjPRIVATE__set_xml_precision(before)

"""A simulator with what it lacked: MJCF, and a list of effects for what MJCF cannot say.

extension = extend(nominal, parameters, causes)
extension.xml          # compiles to the fitted model, to the last digit, with its own step
extension.effects      # all of them; those on commands and in sensors this package replays
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
    causes: tuple[Cause, ...]

    @property
    def beside(self) -> list[Cause]:
        """Those that the MJCF cannot say, in the order in which they act."""
        return [cause for cause in self.causes if not _is_in_mjcf(cause)]

    @property
    def effects(self) -> dict[str, Any]:
        """All of them as JSON."""
        listed = [asdict(cause) | {"in_mjcf": _is_in_mjcf(cause)} for cause in self.causes]
        return {"version": 1, "effects": listed}

    def nominal(self) -> Nominal:
        """The extended model as a simulator without free parameters."""
        return Nominal(self.xml, ParameterSpace(()), np.empty(0))


def _is_in_mjcf(cause: Cause) -> bool:
    return get_mechanism(cause.kind).change is not None


def extend(nominal: Nominal, parameters: Vector, causes: Sequence[Cause]) -> Extension:
    """The model with fitted parameters and causes, written out."""
    spec = nominal.spec(parameters)
    model = with_causes(spec, lambda model: nominal.write(model, parameters), causes)
    spec.copy_back(model)
    return Extension(written_out(spec), tuple(causes))


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

"""The simulator extended by the effects that it lacked: MJCF, and a list of all effects.

extension = extend(nominal, parameters, effects)
extension.xml          # compiles to the fitted model, to the last digit, with its own step
extension.to_json()    # all effects; this package replays those on commands and in sensors
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
from adr_service.criticism.nominal import Nominal
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import with_effects
from adr_service.parameters import ParameterSpace

_DIGITS = 17  # enough for every double


@dataclass(frozen=True)
class Extension:
    """An extended model, as two files have it."""

    xml: str
    effects: tuple[Effect, ...]

    @property
    def beside(self) -> list[Effect]:
        """Effects that MJCF cannot express, in the order in which they act."""
        return [effect for effect in self.effects if not _is_in_mjcf(effect)]

    def to_json(self) -> dict[str, Any]:
        """All effects, as `effects.json` has them."""
        listed = [asdict(effect) | {"in_mjcf": _is_in_mjcf(effect)} for effect in self.effects]
        return {"version": 1, "effects": listed}

    def nominal(self) -> Nominal:
        """The extended model as a simulator without free parameters."""
        return Nominal(self.xml, ParameterSpace(()), np.empty(0))


def _is_in_mjcf(effect: Effect) -> bool:
    return get_mechanism(effect.kind).change is not None


def extend(nominal: Nominal, parameters: Vector, effects: Sequence[Effect]) -> Extension:
    """The model with fitted parameters and effects, written out."""
    spec = nominal.spec(parameters)
    model = with_effects(spec, lambda model: nominal.write(model, parameters), effects)
    spec.copy_back(model)
    for body in spec.bodies[1:]:  # the one field of an effect that MuJoCo does not copy back
        body.gravcomp = float(model.body_gravcomp[model.body(body.name).id])
    return Extension(written_out(spec), tuple(effects))


def written_out(spec: mujoco.MjSpec) -> str:
    """MJCF with all digits of all numbers."""
    with _all_digits():
        return spec.to_xml()


@contextmanager
def _all_digits() -> Generator[None]:
    """Let MuJoCo write more than six digits; its Python module lacks the function for it."""
    folder = Path(mujoco.__file__).parent
    library = ctypes.CDLL(str(next(folder.glob("libmujoco*"))))
    before = library._mjPRIVATE__get_xml_precision()
    library._mjPRIVATE__set_xml_precision(_DIGITS)
    try:
        yield
    finally:
        library._mjPRIVATE__set_xml_precision(before)

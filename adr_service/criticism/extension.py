"""The simulator extended by the effects that it lacked: MJCF, and a list of all effects.

extension = extend(nominal, parameters, effects)
extension.xml          # compiles to the fitted model, to the last digit, with its own step
extension.to_json()    # all effects; this package replays those on commands and in sensors
"""

import ctypes
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.criticism.nominal import Nominal
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import with_effects
from adr_service.parameters import ParameterSpace

_DIGITS = 17  # enough for every double
# attributes that MuJoCo writes out although a file without them means the same
_WRITERS = dict.fromkeys(("simple", "ctrllimited", "forcelimited", "actlimited"), "false")


@dataclass(frozen=True)
class Extension:
    """An extended model, as two files have it."""

    xml: str
    effects: tuple[Effect, ...]
    changes: tuple[str, ...] = ()  # attributes of MJCF that the effects change

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
    without, xml = (_written(nominal, parameters, each) for each in ((), effects))
    return Extension(xml, tuple(effects), tuple(_changes(without, xml, nominal.xml)))


def _written(nominal: Nominal, parameters: Vector, effects: Sequence[Effect]) -> str:
    spec = nominal.spec(parameters)
    model = with_effects(spec, lambda model: nominal.write(model, parameters), effects)
    spec.copy_back(model)
    for body in spec.bodies[1:]:  # the one field of an effect that MuJoCo does not copy back
        body.gravcomp = float(model.body_gravcomp[model.body(body.name).id])
    # what MuJoCo works out from inertias and positions as it compiles is not worked out again
    for number, actuator in enumerate(spec.actuators):
        actuator.biasprm = model.actuator_biasprm[number]
    for number, joint in enumerate(spec.joints):
        if joint.springdamper.any():
            joint.stiffness[0] = model.jnt_stiffness[number]
            joint.damping[0] = model.dof_damping[model.jnt_dofadr[number]]
            joint.springdamper = np.zeros(2)
    for number, tendon in enumerate(spec.tendons):
        tendon.springlength = model.tendon_lengthspring[number]
    return written_out(spec)


def _changes(without: str, xml: str, file: str) -> Iterator[str]:
    """New and changed attributes, by element, as `<joint name="elbow" frictionloss="0.35">`.

    An element that has no name in the user's file is described by the one around it, and a new one
    has its name beside. Inertias are whole, because most files let MuJoCo infer them.
    """
    known = dict(_elements(without))
    for place, attributes in _elements(xml):
        is_new, old = place not in known, _WRITERS | known.get(place, {})
        new = {name: value for name, value in attributes.items() if old.get(name) != value}
        if not new:
            continue
        above, _, last = place.rpartition("/")
        tag = last.partition(" ")[0]
        given = attributes.get("name", "")
        is_named = f'"{given}"' in file
        shown = attributes if tag == "inertial" else new
        shown = {name: value for name, value in shown.items() if name != "name"}
        named = {"name": given} if is_named or (is_new and given) else {}
        words = " ".join(f'{name}="{_short(value)}"' for name, value in (named | shown).items())
        yield f"<{tag} {words}>" + ("" if is_named else f" in {above.rpartition('/')[2]}")


def _elements(xml: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Every element's place, by tags and names from the root on, and its attributes."""
    waiting = [("", ElementTree.fromstring(xml))]  # noqa: S314 - we have written it
    while waiting:
        above, element = waiting.pop()
        place = f"{above}/{element.tag} {element.get('name', '')}".rstrip()
        yield place, dict(element.attrib)
        waiting += [(place, child) for child in reversed(element)]


def _short(value: str) -> str:
    """Numbers with six digits; other words as they are."""
    try:
        return " ".join(f"{float(word):.6g}" for word in value.split())
    except ValueError:
        return value


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

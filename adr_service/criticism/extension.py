"""The simulator extended by the effects that it lacked: MJCF, and a list of all effects.

extension = extend(nominal, parameters, effects)
extension.xml          # compiles to the fitted model, to the last digit, with its own step
extension.to_json()    # all effects; this package replays those that MJCF cannot express
"""

import ctypes
from collections import Counter
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
from adr_service.errors import AdrError
from adr_service.parameters import ParameterSpace

_DIGITS = 17  # enough for every double
_ROUNDING = 1e-12  # of a body's largest moment of inertia
# attributes that MuJoCo writes out although a file without them means the same
_WRITERS = dict.fromkeys(("simple", "ctrllimited", "forcelimited", "actlimited"), "false")
# tag, name or class, and number among siblings that have both, from the root on
_Place = tuple[tuple[str, str, int], ...]
_Attributes = dict[str, str]
_ROOT: _Place = (("mujoco", "", 0),)


class NotWritable(AdrError):
    """An extended model cannot be written as MJCF."""


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
    """The model with fitted parameters and effects, written out.

    Raises NotWritable if MuJoCo refuses what it has simulated.
    """
    without, xml = (_written(nominal, parameters, each) for each in ((), effects))
    return Extension(xml, tuple(effects), tuple(_changes(without, xml, nominal.xml)))


def _written(nominal: Nominal, parameters: Vector, effects: Sequence[Effect]) -> str:
    spec = nominal.spec(parameters)
    model = with_effects(spec, lambda model: nominal.write(model, parameters), effects)
    spec.copy_back(model)
    for body in spec.bodies[1:]:
        # the one field of an effect that MuJoCo does not copy back
        body.gravcomp = float(model.body_gravcomp[model.body(body.name).id])
        body.inertia = _possible(np.array(body.inertia))
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
    try:
        return written_out(spec)
    except ValueError as error:
        words = " ".join(str(error).split())  # MuJoCo's have several lines
        raise NotWritable(f"MuJoCo cannot write the extended model; it says: {words}") from error


def _possible(inertia: Vector) -> Vector:
    """Moments of inertia (3,) without a rounding error by which one exceeds the others' sum, which
    it equals in a flat body."""
    largest = int(np.argmax(inertia))
    others = float(np.delete(inertia, largest).sum())
    if others < inertia[largest] <= (1 + _ROUNDING) * others:
        inertia[largest] = others
    return inertia


def _changes(without: str, xml: str, file: str) -> Iterator[str]:
    """New and changed attributes, by element, as `<joint name="elbow" frictionloss="0.35">`.

    An element that has no name in the user's file is described by the one around it, and a new one
    has its name beside. Inertias are whole, because most files let MuJoCo infer them.
    """
    roots = (ElementTree.fromstring(text) for text in (without, xml))  # noqa: S314 - our own
    before, after = (_elements(root, _ROOT) for root in roots)
    known = dict(before)
    for place, attributes in after:
        is_new, old = place not in known, _WRITERS | known.get(place, {})
        new = {name: value for name, value in attributes.items() if old.get(name) != value}
        if not new:
            continue
        tag = place[-1][0]
        given = attributes.get("name", "")
        is_named = f'"{given}"' in file
        shown = attributes if tag == "inertial" else new
        shown = {name: value for name, value in shown.items() if name != "name"}
        named = {"name": given} if is_named or (is_new and given) else {}
        words = " ".join(f'{name}="{_short(value)}"' for name, value in (named | shown).items())
        around = "" if is_named else f" in {' '.join(place[-2][:2]).rstrip()}"
        yield f"<{tag} {words}>{around}"


def _elements(element: ElementTree.Element, place: _Place) -> Iterator[tuple[_Place, _Attributes]]:
    """Every element within one at this place, with its own place and attributes."""
    alike = Counter[tuple[str, str]]()
    for child in element:
        label = child.tag, child.get("name", child.get("class", ""))
        inside = (*place, (*label, alike[label]))
        alike[label] += 1
        yield inside, dict(child.attrib)
        yield from _elements(child, inside)


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

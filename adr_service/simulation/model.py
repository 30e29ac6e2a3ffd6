"""Addresses of parameters in a MuJoCo model: address -> model field and elements.

    body:thigh.mass          mass of one body [kg]; its inertia stays ("as published")
    body:thigh.inertial      mass, the inertia scaled with it ("consistent")
    joint:slide.damping      viscous damping [N s/m or N m s/rad]
    joint:elbow.armature     inertia of its drive [kg or kg m²]
    joint:elbow.stiffness    spring towards its reference [N/m or N m/rad]
    actuator:push.gear       motor gear, force per unit of control [N or N m]
    actuator:push.bias       constant of an affine bias, in the unit of its force before the gear
    pair:left.friction       sliding friction of an explicit contact pair, both directions
    pair:*.friction          of all pairs alike; so with every kind above
    link:thigh.length        [m]; the task reshapes the model, which is compiled anew (links.py)

To randomise another quantity, add a row to `FIELDS`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from adr_service.arrays import Indices, Matrix
from adr_service.errors import InvalidInput, UnknownName
from adr_service.tasks.base import Source


@lru_cache(maxsize=32)
def compiled(xml: str) -> mujoco.MjModel:
    """The model of an MJCF text; shared, so do not change it."""
    try:
        return mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise InvalidInput(f"MuJoCo cannot compile the model: {error}") from error


def not_a_model(name: str, error: ValueError) -> InvalidInput:
    """The refusal of a file, or of another text, that MuJoCo cannot read."""
    words = " ".join(str(error).split())  # MuJoCo's have several lines
    return InvalidInput(f"{name} is no MJCF or URDF that MuJoCo can read; it says: {words}")


def action_names(xml: str) -> list[str]:
    """Names of a model's actuators: their own, else their joint's, else `actuator_<number>`."""
    model = compiled(xml)
    return [_action_name(model, i) for i in range(model.nu)]


def _action_name(model: mujoco.MjModel, actuator: int) -> str:
    if name := model.actuator(actuator).name:
        return name
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        return model.joint(model.actuator_trnid[actuator, 0]).name
    return f"actuator_{actuator}"


@dataclass(frozen=True)
class Slot:
    """The elements of one model field that take a parameter's value, in every simulation."""

    field: str  # MjModel field
    elements: tuple[tuple[int, ...], ...]  # indices into it
    scaled: str | None = None  # a field of the same objects that scales with the value


@dataclass(frozen=True)
class Quantity:
    """One attribute of a kind of object, as the model has it."""

    field: str  # MjModel field
    units: tuple[str, ...]  # one, or that of hinges and that of slides
    columns: tuple[tuple[int, ...], ...] = ((),)  # within an object's row
    scaled: str | None = None  # a field of the same objects that scales with the value


FIELDS: dict[tuple[str, str], Quantity] = {  # by (object kind, attribute)
    ("body", "mass"): Quantity("body_mass", ("kg",)),
    ("body", "inertial"): Quantity("body_mass", ("kg",), scaled="body_inertia"),
    ("joint", "damping"): Quantity("dof_damping", ("N m s/rad", "N s/m")),
    ("joint", "armature"): Quantity("dof_armature", ("kg m²", "kg")),
    ("joint", "stiffness"): Quantity("jnt_stiffness", ("N m/rad", "N/m")),
    ("actuator", "gear"): Quantity("actuator_gear", ("N m", "N"), ((0,),)),
    ("actuator", "bias"): Quantity("actuator_biasprm", ("of the force before the gear",), ((0,),)),
    ("pair", "friction"): Quantity("pair_friction", ("1",), ((0,), (1,))),
}


def link_of(address: str) -> str | None:
    """The link whose length an address names; None for all other addresses."""
    match = re.fullmatch(r"link:(.+)\.length", address)
    return match.group(1) if match else None


def addresses_of(source: Source) -> list[str]:
    """The addresses of a source's fixed values, then of its parameters."""
    return [*source.fixed, *(p.address for p in source.space.parameters)]


def links_of(source: Source) -> list[str]:
    """The links whose lengths a source fixes or leaves unknown."""
    return [link for address in addresses_of(source) if (link := link_of(address)) is not None]


def resolve(model: mujoco.MjModel, address: str) -> Slot:
    """The slot of an address."""
    quantity, rows, _ = _found(model, address)
    elements = tuple((row, *column) for row in rows for column in quantity.columns)
    return Slot(quantity.field, elements, quantity.scaled)


def check_written_once(model: mujoco.MjModel, source: Source) -> None:
    """Raise InvalidInput if two addresses of a source set one element, or one length.

    Another address of the same attribute may set anew what a fixed value sets by a `*`.
    """
    owners: dict[tuple[str, tuple[int, ...]], str] = {}
    for address in addresses_of(source):
        for place in _places(model, address):
            first = owners.get(place)
            is_general = first is not None and "*" in first and first in source.fixed
            if first is not None and not (is_general and _attribute(first) == _attribute(address)):
                field, element = place
                raise InvalidInput(
                    f"{first} and {address} both set {field}{list(element) or ''}; a value may "
                    "have one address among the parameters and fixed values"
                )
            owners[place] = address


def _places(model: mujoco.MjModel, address: str) -> list[tuple[str, tuple[int, ...]]]:
    """The elements that an address sets, each with its field; of a length, the address alone."""
    if link_of(address) is not None:
        return [(address, ())]
    slot = resolve(model, address)
    return [(slot.field, element) for element in slot.elements]


def _attribute(address: str) -> str:
    return address.rpartition(".")[2]


def unit_at(model: mujoco.MjModel, address: str) -> str:
    """The unit of an address's values, as "N m"; "N m or N" where it depends on what is driven."""
    quantity, _, objects = _found(model, address)
    units = quantity.units
    if quantity.field.startswith(("dof_", "jnt_")):
        are_slides = {bool(model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE) for i in objects}
        units = [units[is_slide] for is_slide in sorted(are_slides)]
    return " or ".join(units)


def _found(model: mujoco.MjModel, address: str) -> tuple[Quantity, list[int], list[int]]:
    """The quantity of an address, the rows of its field, and the numbers of its objects."""
    match = re.fullmatch(r"(\w+):(.+)\.(\w+)", address)
    if match is None:
        raise InvalidInput(f"address {address!r} is not of the form kind:name.attribute")
    kind, name, attribute = match.groups()
    if (kind, attribute) not in FIELDS:
        accepted = [*(f"{k}:….{a}" for k, a in FIELDS), "link:….length"]
        raise UnknownName("address", f"{kind}:….{attribute}", accepted)
    quantity = FIELDS[kind, attribute]
    names = _names(model, kind)
    # by number, because elements need no name
    every = range(1 if kind == "body" else 0, len(names))  # the world is no body
    if name != "*" and name not in names:
        raise UnknownName(kind, name, [names[number] for number in every])
    objects = list(every) if name == "*" else [names.index(name)]
    able = [number for number in objects if _has(model, quantity, number)]
    if not able:
        why = _WITHOUT[quantity.field] if objects else f"the model has no {kind}"
        raise InvalidInput(f"{address} does nothing: {why}")
    objects = able
    if not quantity.field.startswith("dof_"):
        return quantity, objects, objects
    return quantity, [int(model.jnt_dofadr[i]) for i in objects], objects  # first of each joint


# why an object of a kind may lack a quantity
_WITHOUT = {
    "body_mass": "the world does not move, and a body without mass has no inertia to scale",
    "actuator_biasprm": "the force of the actuator has no bias (biastype affine has one)",
    "dof_damping": "a free or a ball joint has several, and no address for them",
    "dof_armature": "a free or a ball joint has several, and no address for them",
}


def _has(model: mujoco.MjModel, quantity: Quantity, number: int) -> bool:
    """True if a quantity of an object takes part in its physics, and is one number."""
    field = quantity.field
    if field == "body_mass":
        has_inertia = quantity.scaled is None or bool(model.body_mass[number] > 0)
        return number > 0 and has_inertia
    if field == "actuator_biasprm":
        return bool(model.actuator_biastype[number] == mujoco.mjtBias.mjBIAS_AFFINE)
    single = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
    return not field.startswith("dof_") or int(model.jnt_type[number]) in single


def write(model: mujoco.MjModel, slot: Slot, value: float) -> None:
    """Write a parameter's value into one model; the caller updates the derived constants."""
    for element in slot.elements:
        array = getattr(model, slot.field)
        if slot.scaled is not None:
            getattr(model, slot.scaled)[element] *= value / array[element]
        array[element] = value


def read(model: mujoco.MjModel, slot: Slot) -> float:
    """A parameter's value in one model."""
    return float(getattr(model, slot.field)[slot.elements[0]])


class Writer:
    """Writes parameters into the simulations of a batch, one assignment per model field."""

    def __init__(self, batch: Batch, slots: Mapping[int, Slot]):
        """`slots` maps columns of the values to their slots."""
        self._fields: list[_Field] = []
        for name, scaled in dict.fromkeys((slot.field, slot.scaled) for slot in slots.values()):
            targets = [
                (column, element)
                for column, slot in slots.items()
                for element in slot.elements
                if (slot.field, slot.scaled) == (name, scaled)
            ]
            columns = np.array([column for column, _ in targets])
            index = tuple(np.array([element for _, element in targets]).T)
            self._fields.append(_Field(batch.expand(name), index, columns, None))
            if scaled is not None:
                nominal = getattr(batch.model, name)[index]
                per_unit = getattr(batch.model, scaled)[index] / nominal[:, None]
                self._fields.append(_Field(batch.expand(scaled), index, columns, per_unit))

    def write(self, values: Matrix, rows: Indices) -> None:
        """Give simulations `rows` (n,) their `values` (n, d)."""
        for field in self._fields:
            where = (rows[:, None], *field.index)
            chosen = values[:, field.columns]
            scale = field.per_unit
            field.array[where] = chosen if scale is None else chosen[..., None] * scale


@dataclass(frozen=True)
class _Field:
    """Destination of some columns of the values in one expanded field."""

    array: NDArray[Any]  # (n, ...)
    index: tuple[Indices, ...]  # elements, by dimension
    columns: Indices  # of the values, for each element
    per_unit: Matrix | None  # field's value per unit of the parameter; None: the parameter itself


def _names(model: mujoco.MjModel, kind: str) -> list[str]:
    count = {"body": model.nbody, "joint": model.njnt, "actuator": model.nu, "pair": model.npair}
    return [getattr(model, kind)(i).name for i in range(count[kind])]


def differs(one: mujoco.MjModel, other: mujoco.MjModel, field: str) -> bool:
    """True if two models differ in a field; options of the solver are not compared."""
    return not field.startswith("opt.") and not np.array_equal(
        getattr(one, field), getattr(other, field)
    )

"""Where a parameter's value goes in a MuJoCo model: address -> model field and element.

    body:thigh.mass          mass of one body [kg]; its inertia stays ("as published")
    body:thigh.inertial      mass, the inertia scaled with it ("consistent")
    joint:slide.damping      viscous damping [N s/m or N m s/rad]
    actuator:push.gear       motor gear, force per unit of control [N or N m]

To randomise another quantity, add a row to `FIELDS`.
"""

import re
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from adr_service.arrays import Matrix
from adr_service.errors import InvalidInput, UnknownName


@dataclass(frozen=True)
class Slot:
    """One element of one model field, of every simulation of a batch."""

    field: str  # MjModel field
    index: tuple[int, ...]  # element of it
    scaled: str | None = None  # a field of the same object that scales with the value


# (object kind, attribute) -> (MjModel field, column within the object's row, scaled field)
FIELDS: dict[tuple[str, str], tuple[str, tuple[int, ...], str | None]] = {
    ("body", "mass"): ("body_mass", (), None),
    ("body", "inertial"): ("body_mass", (), "body_inertia"),
    ("joint", "damping"): ("dof_damping", (0,), None),
    ("actuator", "gear"): ("actuator_gear", (0,), None),
}


def resolve(model: mujoco.MjModel, address: str) -> Slot:
    """The slot an address names."""
    match = re.fullmatch(r"(\w+):(\w+)\.(\w+)", address)
    if match is None:
        raise InvalidInput(f"address {address!r} is not of the form kind:name.attribute")
    kind, name, attribute = match.groups()
    if (kind, attribute) not in FIELDS:
        raise UnknownName("address", f"{kind}:….{attribute}", [f"{k}:….{a}" for k, a in FIELDS])
    field, column, scaled = FIELDS[kind, attribute]
    try:
        view = getattr(model, kind)(name)
    except KeyError:
        raise UnknownName(kind, name, _names(model, kind)) from None
    if field.startswith("dof_"):  # a joint's first degree of freedom
        return Slot(field, (int(model.jnt_dofadr[view.id]),), scaled)
    return Slot(field, (view.id, *column), scaled)


def write(batch: Batch, slot: Slot, values: Matrix, rows: slice | list[int]) -> None:
    """Give simulations `rows` their own value (n,) of a slot."""
    expanded = batch.expand(slot.field)
    if slot.scaled is not None:
        nominal = getattr(batch.model, slot.scaled)[slot.index]
        factor = values / getattr(batch.model, slot.field)[slot.index]
        batch.expand(slot.scaled)[(rows, *slot.index)] = factor[:, None] * np.asarray(nominal)
    expanded[(rows, *slot.index)] = values


def _names(model: mujoco.MjModel, kind: str) -> list[str]:
    count = {"body": model.nbody, "joint": model.njnt, "actuator": model.nu}[kind]
    return [getattr(model, kind)(i).name for i in range(count)]

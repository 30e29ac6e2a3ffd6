"""The simulator under criticism, which may be wrong: a model and its free parameters.

nominal = Nominal.of_task(task, source)
model = nominal.model(nominal.start, effects)       # a compiled MjModel
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.effects.base import Effect
from adr_service.effects.models import (
    elements_of,
    make_inertias_explicit,
    name_all,
    prepared,
    write_all,
)
from adr_service.errors import InvalidInput
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.simulation.model import (
    check_written_once,
    link_of,
    not_a_model,
    read,
    resolve,
    write,
)
from adr_service.tasks.base import Reshapable, Source, Task

Lengths = tuple[tuple[str, float], ...]  # of links, by name
_NOT_NEGATIVE = ("body_mass", "dof_damping", "dof_armature")  # fields
_ROUNDING = 1e-9  # relative: values of a model as near as that are the same


@dataclass(frozen=True)
class Nominal:
    """A model whose free parameters may be fitted before anything is called wrong."""

    xml: str
    space: ParameterSpace  # free parameters
    start: Vector  # (d,) where the fit begins [SI]
    fixed: Mapping[str, float] = field(default_factory=dict[str, float])  # address -> value
    task: Task | None = None  # whose links can be reshaped, where lengths are parameters
    folder: str = ""  # in which the model looks for meshes and textures; written out as well

    @classmethod
    def of_task(cls, task: Task, source: Source) -> "Nominal":
        """A task's simulator as its file has it, with a source's parameters free, except link
        lengths, which stay. Raises InvalidInput if the source has effects already."""
        if source.effects:
            raise InvalidInput(f"{task.name} is extended already; criticise it as its file has it")
        free = [p.name for p in source.space.parameters if link_of(p.address) is None]
        return cls.of_model(task.xml, source.space.subset(tuple(free)), source.fixed, task)

    @classmethod
    def of_model(
        cls,
        xml: str,
        space: ParameterSpace,
        fixed: Mapping[str, float] | None = None,
        task: Task | None = None,
        folder: str = "",
    ) -> "Nominal":
        """A model whose free parameters start at the values that its file has.

        Raises InvalidInput for a parameter whose bounds do not hold that value or go below what a
        simulation can have, and for one that sets several elements which differ in the file, or an
        element that another address sets too.
        """
        whole = cls(xml, ParameterSpace(()), np.empty(0), fixed or {}, task, folder)
        model = whole.model(whole.start)
        check_written_once(model, Source(space, whole.fixed))
        start = [_start_of(p, model) for p in space.parameters]
        return cls(xml, space, np.array(start), fixed or {}, task, folder)

    def model(self, values: Vector, effects: Sequence[Effect] = ()) -> mujoco.MjModel:
        """The compiled model with parameters (d,) and effects."""
        bare = self.bare(self.lengths(values), elements_of(effects))
        return self.completed(bare, values, effects)

    def bare(self, lengths: Lengths, elements: tuple[Effect, ...]) -> mujoco.MjModel:
        """The compiled model of these link lengths with the elements that effects need."""
        return prepared(self._spec(lengths), elements)

    def completed(
        self, bare: mujoco.MjModel, values: Vector, effects: Sequence[Effect]
    ) -> mujoco.MjModel:
        """A copy of what `bare` makes for parameters and effects, with all of them in it."""
        model = copy(bare)
        write_all(model, lambda model: self.write(model, values), effects)
        return model

    def lengths(self, values: Vector) -> Lengths:
        """Links and their lengths [m], where these are parameters or fixed."""
        known = self.addressed(values).items()
        return tuple((link, value) for a, value in known if (link := link_of(a)) is not None)

    def spec(self, values: Vector) -> mujoco.MjSpec:
        """The model's source, with names for all elements, reshaped if lengths are parameters."""
        return self._spec(self.lengths(values))

    def _spec(self, lengths: Lengths) -> mujoco.MjSpec:
        spec = self._read()
        name_all(spec)
        spec.compiler.fusestatic = False  # bodies without a joint are places of effects
        make_inertias_explicit(spec)
        if spec.compiler.settotalmass > 0:
            raise InvalidInput(
                "the model scales its masses by settotalmass, which no effect in a body survives; "
                "write the masses out (MjSpec.to_xml does) and leave it away"
            )
        if lengths:
            assert isinstance(self.task, Reshapable)
            self.task.reshape(spec, dict(lengths))
        return spec

    def _read(self) -> mujoco.MjSpec:
        try:
            spec = mujoco.MjSpec.from_string(self.xml)
        except ValueError as error:
            raise not_a_model("the model", error) from error
        if self.folder:
            paths: Any = spec  # whose stub lacks these two
            paths.meshdir = str(Path(self.folder) / paths.meshdir)
            paths.texturedir = str(Path(self.folder) / paths.texturedir)
        return spec

    def addressed(self, values: Vector) -> dict[str, float]:
        """All values that the simulator takes, by address."""
        addresses = [parameter.address for parameter in self.space.parameters]
        return {**self.fixed, **dict(zip(addresses, values.tolist(), strict=True))}

    def write(self, model: mujoco.MjModel, values: Vector) -> None:
        """Put parameters (d,) into a compiled model."""
        for address, value in self.addressed(values).items():
            if link_of(address) is None:
                write(model, resolve(model, address), value)


def _start_of(parameter: Parameter, model: mujoco.MjModel) -> float:
    """The one value that a model has for a parameter, within bounds that can be simulated."""
    slot = resolve(model, parameter.address)
    value, low, name = read(model, slot), parameter.feasible_low, parameter.name
    held = [float(getattr(model, slot.field)[element]) for element in slot.elements]
    if not np.allclose(held, value, rtol=_ROUNDING, atol=0):
        raise InvalidInput(
            f"{name} sets {len(held)} values alike, and the model has {min(held):g} to "
            f"{max(held):g} for them; make them equal in the model, or free each by its own address"
        )
    if slot.field in _NOT_NEGATIVE and low < 0:
        raise InvalidInput(f"the lower bound of {name} is {low:g}; accepted are 0 and more")
    if not low <= value <= parameter.high:
        raise InvalidInput(
            f"the model has {value:g} for {name}, which is outside of its bounds: "
            f"{low:g} to {parameter.high:g}"
        )
    return value

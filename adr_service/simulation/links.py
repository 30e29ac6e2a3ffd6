"""Link lengths as parameters: the models of a task whose robot is reshaped for every draw.

A draw of lengths is compiled, and the model fields that lengths change are copied into a batch.
"""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from adr_service.arrays import Indices, Matrix
from adr_service.errors import InvalidInput
from adr_service.simulation.model import addresses_of, differs, link_of, links_of
from adr_service.tasks.base import Reshapable, Source, Task


class LinkLengths:
    """The models of a task with other link lengths than its file has.

    `base` has the lengths of the file, or of the source where it fixes them.
    """

    def __init__(self, task: Task, source: Source):
        self._task = _reshapable(task, source)
        self._name = task.name
        fixed = {link_of(address): value for address, value in source.fixed.items()}
        self._fixed = {link: value for link, value in fixed.items() if link is not None}
        self._columns = {
            link: source.space.index(p.name)
            for p in source.space.parameters
            if (link := link_of(p.address)) is not None
        }
        self._spec = _without_textures(task.xml)
        self.base = self._compiled(mujoco.MjSpec.from_string(task.xml), {})
        for link, length in self._fixed.items():
            self._changed(link, length, 1.1 * length)
        ranges = {link: source.space.parameters[i] for link, i in self._columns.items()}
        changed = [self._changed(link, p.low, p.high) for link, p in ranges.items()]
        self._fields: list[str] = sorted(set().union(*changed))
        self._expanded: list[NDArray[Any]] = []  # of a batch

    def expand(self, batch: Batch) -> None:
        """Let the simulations of a batch have geometries of their own."""
        self._expanded = [batch.expand(name) for name in self._fields]

    def write(self, dynamics: Matrix, rows: Indices) -> None:
        """Give simulations `rows` the geometry of their draws, a row of `dynamics` each."""
        lengths = dynamics[:, list(self._columns.values())]
        for draw in lengths if len(rows) == 1 else np.unique(lengths, axis=0):
            model = self._compiled(self._spec, dict(zip(self._columns, draw.tolist(), strict=True)))
            same = rows[np.all(lengths == draw, axis=1)]
            for array, name in zip(self._expanded, self._fields, strict=True):
                array[same] = getattr(model, name)

    def _changed(self, link: str, short: float, long: float) -> set[str]:
        """The model fields that the length of a link changes."""
        one, other = (self._compiled(self._spec, {link: length}) for length in (short, long))
        fields = {name for name in MODEL_FIELDS if differs(one, other, name)}
        if not fields:
            raise InvalidInput(
                f"link:{link}.length changes nothing: {self._name} reshapes no such link"
            )
        return fields

    def _compiled(self, spec: mujoco.MjSpec, lengths: Mapping[str, float]) -> mujoco.MjModel:
        self._task.reshape(spec, {**self._fixed, **lengths})
        try:
            return spec.compile()
        except ValueError as error:
            raise InvalidInput(f"lengths {lengths} of {self._name}: {error}") from error


def _reshapable(task: Task, source: Source) -> Reshapable:
    """The task, if the lengths that its source names can be parameters of it."""
    if not isinstance(task, Reshapable):
        raise InvalidInput(
            f"{task.name} cannot be reshaped, so the lengths of {', '.join(links_of(source))} "
            "cannot be parameters; give the task a method `reshape`"
        )
    if scaled := [a for a in addresses_of(source) if a.endswith(".inertial")]:
        raise InvalidInput(
            f"{', '.join(scaled)} would scale an inertia that a length changes too; where "
            "lengths are parameters, use body:….mass"
        )
    return task


def _without_textures(xml: str) -> mujoco.MjSpec:
    """The model without materials and textures, which take most of its compilation time."""
    spec = mujoco.MjSpec.from_string(xml)
    for element in (*spec.geoms, *spec.sites, *spec.tendons, *spec.skins):
        element.material = ""
    for asset in (*spec.materials, *spec.textures):
        spec.delete(asset)
    return spec

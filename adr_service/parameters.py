"""The unknown parameters of a simulator: named, addressed, bounded and ordered.

    space = ParameterSpace((Parameter("torso_mass", "body:torso.mass", "kg", 0.5, 10.0, 0.1),))
    x = space.normalise(values)      # SI <-> [0, 4]

Parameters are data: an address names the value's place in the model, so they pickle and are JSON.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adr_service.arrays import Vector, frozen
from adr_service.errors import InvalidInput, UnknownName


@dataclass(frozen=True)
class Parameter:
    """One scalar of the simulator that may be unknown, in SI units.

    `low` and `high` bound the search for the distribution's mean. `feasible_low` is the
    smallest value that can be simulated; no draw is below it.
    """

    name: str
    address: str  # place in the model, "body:thigh.mass" (simulation/model.py)
    unit: str
    low: float
    high: float
    feasible_low: float

    def __post_init__(self) -> None:
        bounds = (self.feasible_low, self.low, self.high)
        if not (self.feasible_low <= self.low < self.high and np.isfinite(bounds).all()):
            raise InvalidInput(
                f"parameter {self.name!r} needs feasible_low <= low < high, all finite; "
                f"given {self.feasible_low}, {self.low}, {self.high}"
            )


@dataclass(frozen=True)
class ParameterSpace:
    """An ordered tuple of parameters; every vector of values follows this order."""

    parameters: tuple[Parameter, ...]
    WIDTH: ClassVar[float] = 4.0  # the paper normalises every parameter to [0, 4]

    def __post_init__(self) -> None:
        names = [p.name for p in self.parameters]
        if len(set(names)) != len(names):
            raise InvalidInput(f"parameter names must be unique; given {', '.join(names)}")

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
    def low(self) -> Vector:
        return frozen([p.low for p in self.parameters])

    @property
    def high(self) -> Vector:
        return frozen([p.high for p in self.parameters])

    @property
    def feasible_low(self) -> Vector:
        return frozen([p.feasible_low for p in self.parameters])

    @property
    def scale(self) -> Vector:
        """SI units per normalised coordinate, (d,)."""
        return (self.high - self.low) / self.WIDTH

    def index(self, name: str) -> int:
        if name not in self.names:
            raise UnknownName("parameter", name, self.names)
        return self.names.index(name)

    def subset(self, names: tuple[str, ...]) -> "ParameterSpace":
        return ParameterSpace(tuple(self.parameters[self.index(name)] for name in names))

    def normalise(self, values: Vector) -> Vector:
        """SI values (..., d) as coordinates in which the search box is [0, 4]^d."""
        return self.WIDTH * (np.asarray(values) - self.low) / (self.high - self.low)

    def denormalise(self, coordinates: Vector) -> Vector:
        """The inverse of `normalise`."""
        return self.low + np.asarray(coordinates) * (self.high - self.low) / self.WIDTH

    def at_bound(self, values: Vector) -> list[str]:
        """Names of the parameters within a hundredth of their range of a bound, or beyond it."""
        x, near = self.normalise(values), self.WIDTH / 100
        return [self.names[i] for i in np.flatnonzero((x < near) | (x > self.WIDTH - near))]

"""One physical effect at one place, and the mechanisms that effects are instances of.

    effect = Effect("joint_coulomb_friction", "joint:leg_joint", (2.0,))
    domain = domain_of("vanilla", [effect])      # vanilla@[{"kind": …}]

A *mechanism* is a kind of effect: `joints.py` and its neighbours have one after the other, each
under the functions that it needs, and `catalogue.py` collects them. A *domain* is the name of a
task's variant with effects beyond its own.
"""

from __future__ import annotations  # the types of MuJoCo are not imported

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import AllowInfNan, ConfigDict, Field, GetCoreSchemaHandler, Strict
from pydantic_core import CoreSchema, core_schema

from adr_service.arrays import Matrix, Vector
from adr_service.errors import InvalidInput
from adr_service.json_values import canonical_json, refuse_unknown_fields

if TYPE_CHECKING:  # MuJoCo takes a while to import, and nothing here runs it
    import mujoco

ADDED = "adr_"  # opens the name of every element that a mechanism adds to a model
SENSOR_SIZE = 0.005  # [rad, m, rad/s or m/s] typical size of a sensor's error
# control steps by which late commands are tried as well: their effect is in proportion between one
# whole step and the next
LATE = (1.5, 2.75)
_SEPARATOR = "@"
_Text = Annotated[str, Strict(), Field(max_length=1000)]
_Number = Annotated[float, Strict(), AllowInfNan(False)]


@dataclass(frozen=True)
class Effect:
    """One physical effect at one place, with its strengths."""

    # the constructor checks nothing, because a fit may try strengths that make no sense; a field of
    # a pydantic model checks its JSON

    kind: Annotated[
        _Text,
        Field(
            description="mechanism, as joint_coulomb_friction; docs/reference/effects.md lists all"
        ),
    ]
    location: Annotated[_Text, Field(description="as joint:elbow, or global")]
    values: Annotated[
        tuple[_Number, ...],
        Field(min_length=1, max_length=100, description="strengths in the mechanism's order"),
    ]

    __pydantic_config__ = ConfigDict(extra="forbid")

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        names = [field.name for field in fields(cls)]
        return core_schema.no_info_before_validator_function(
            lambda given: refuse_unknown_fields(given, names), handler(source)
        )

    @property
    def name(self) -> str:
        """Name of the element at the location, without its kind."""
        return self.location.partition(":")[2]


def domain_of(variant: str, effects: Sequence[Effect]) -> str:
    """The variant with these effects, or the bare variant if there are none."""
    listed = canonical_json([asdict(effect) for effect in effects])
    return variant + _SEPARATOR + listed if effects else variant


def parse_domain(domain: str) -> tuple[str, tuple[Effect, ...]]:
    """The variant and the effects of a domain."""
    variant, _, listed = domain.partition(_SEPARATOR)
    values = json.loads(listed) if listed else []
    return variant, tuple(Effect(v["kind"], v["location"], tuple(v["values"])) for v in values)


Place = Literal["joint", "actuator", "body", "geom", "sensor", "global"]
# numbers of elements are MuJoCo's; of a sensor, its column in the states
Change: TypeAlias = "Callable[[mujoco.MjModel, int, Vector], None]"
Prepare: TypeAlias = "Callable[[mujoco.MjSpec, str], None]"
Typical: TypeAlias = "Callable[[mujoco.MjModel, int], tuple[float, ...]]"
Applies: TypeAlias = "Callable[[mujoco.MjModel, int], bool]"
Columns: TypeAlias = "Callable[[mujoco.MjModel, int], list[int]]"


@dataclass(frozen=True)
class Strength:
    """One parameter of a mechanism, which has no effect at zero."""

    name: str
    unit: str  # on a hinge, "of the sensor" for its own
    low: float = -np.inf  # smallest value that makes sense
    # True if it says how the others act, and not how much: only all of these at zero are nothing
    is_shape: bool = False


@dataclass(frozen=True)
class Commands:
    """Commands to one actuator, at every simulator step of every recorded episode."""

    values: Matrix  # (episodes, T) in units of control; after an episode's end, its last
    timestep: float  # [s]
    largest: float  # bound of what the actuator obeys


Command = Callable[[Commands, Vector], Matrix]
# (n, k) forces, or frictions, that each of k strengths adds on a joint at n angles; nothing for a
# shape
ByAngle = Callable[[Vector, Vector], Matrix]


@dataclass(frozen=True)
class Motion:
    """States of a robot at n moments, and the column that one sensor shows of them."""

    states: Matrix  # (n, 2 nv) positions, then velocities
    # (n, 2 nv) of change [1/s] just before, at an episode's first row just after; zero if no effect
    # needs them
    rates: Matrix
    column: int
    # (n, k) how far the column has come since each of the moments before, the latest first; without
    # columns unless the effect uses the past
    past: Matrix


@dataclass(frozen=True)
class JointState:
    """One joint at n moments."""

    positions: Vector  # (n,)
    torques: Vector  # (n,) of its drives [N m or N]; zero unless they are used


@dataclass(frozen=True)
class Friction:
    """Coulomb friction of a joint that depends on its state."""

    # (n,) [N m or N]; with the model's own it is never less than none
    added: Callable[[JointState, Vector], Vector]
    uses_torques: bool = False  # `JointState.torques` are needed


Offset = Callable[[Motion, Vector], Vector]
Past = Callable[[int], Matrix]  # `Motion.past` of a column
Record = Callable[[Matrix, Vector, float], Matrix]


def _own_column(model: mujoco.MjModel, sensor: int) -> list[int]:
    return [sensor]


@dataclass(frozen=True)
class Sensing:
    """Difference between the readings of one sensor, or of several alike, and the truth."""

    offset: Offset  # (n,) reading minus truth, by the true motion
    # readings (episodes, rows) of whole true episodes at a period [s], exact in its steps;
    # None: readings spread, but none moves on average
    record: Record | None
    offset_shown: Offset | None = None  # `offset` by the motion as sensors show it, if it differs
    columns: Columns = _own_column  # of the states, by the element at the effect's place
    # seconds up to a moment over which it needs the rate of a velocity, by its strengths; None: it
    # needs no rate
    window: Callable[[Vector], float] | None = None
    uses_past: bool = False  # `Motion.past` is needed


@dataclass(frozen=True)
class Mechanism:
    """A kind of effect; exactly one of `change`, `command`, `sensing` and `friction` says how it
    acts."""

    kind: str
    place: Place
    strengths: tuple[Strength, ...]
    typical: Typical  # sizes of the strengths that a sensible simulator might lack
    change: Change | None = None  # of the compiled model
    prepare: Prepare | None = None  # adds the elements that `change` needs, at zero strength
    command: Command | None = None  # what the actuator obeys instead
    is_late: bool = False  # True if a command that holds is obeyed differently at first
    sensing: Sensing | None = None
    friction: Friction | None = None  # of its joint
    applies: Applies = lambda model, element: True  # True if it makes sense at a place
    sizes: tuple[float, ...] = (1.0,)  # times typical, for effects that are not in proportion
    in_force: bool = False  # True if joint forces are in proportion to its strength
    # deviations of the strengths that real robots have and models lack; None: 25 times typical
    likely: Typical | None = None
    has_sides: bool = False  # True if more and less of it are effects of their own
    needs_first: bool = False  # True if its other strengths do nothing while the first is zero
    includes: str = ""  # kind that it equals while its last strengths are zero
    # of a force or a friction on a hinge that repeats with its angle: scans need no simulation, and
    # take its shape, the number of waves in a turn, from the data
    by_angle: ByAngle | None = None

    def __post_init__(self) -> None:
        known = ("change", "command", "sensing", "friction")
        ways = [name for name in known if getattr(self, name)]
        if len(ways) != 1:
            raise InvalidInput(
                f"mechanism {self.kind} has {' and '.join(ways) or 'nothing'}; give it exactly "
                "one of change, command, sensing and friction"
            )
        if self.friction is not None and self.place != "joint":
            raise InvalidInput(
                f"mechanism {self.kind} is a friction at a {self.place}; accepted: at a joint"
            )
        shapes = sum(strength.is_shape for strength in self.strengths)
        if shapes != (self.by_angle is not None) or (shapes and self.place != "joint"):
            raise InvalidInput(
                f"mechanism {self.kind} at a {self.place} has {shapes} shapes; a shape is the "
                "number of waves in a turn of a force by_angle on a joint, which has one"
            )

    @property
    def tries(self) -> int:
        """Number of sizes at which it is tried."""
        return len(self.sizes) + (len(LATE) if self.is_late else 0)

    @property
    def only_spreads(self) -> bool:
        """True if it moves nothing on average, so that only the readings' spread shows it."""
        return self.sensing is not None and self.sensing.record is None

    def locations(self, model: mujoco.MjModel) -> list[str]:
        """Places of a model that may have the effect."""
        if self.place == "global":
            return ["global"]
        if self.place == "sensor":
            return [f"sensor:{name}" for name in sensors(model)]
        count = {
            "joint": model.njnt,
            "actuator": model.nu,
            "body": model.nbody,
            "geom": model.ngeom,
        }
        first = 1 if self.place == "body" else 0  # the world is no body
        return [
            f"{self.place}:{getattr(model, self.place)(i).name}"
            for i in range(first, count[self.place])
            if self.applies(model, i) and not is_added(getattr(model, self.place)(i).name)
        ]


def sensors(model: mujoco.MjModel) -> list[str]:
    """Names of the measured columns: positions, then velocities, by joint."""
    names = [model.joint(int(model.dof_jntid[dof])).name for dof in range(model.nv)]
    return [f"{n}.position" for n in names] + [f"{n}.velocity" for n in names]


def delayed(values: Matrix, steps: float) -> Matrix:
    """Values (episodes, T) a number of steps late, between two of them on a line; an episode's
    first is held before it."""
    whole, count = int(steps), values.shape[1]
    part, before = steps - whole, np.repeat(values[:, :1], whole + 1, axis=1)
    known = np.concatenate([before, values], axis=1)
    return (1 - part) * known[:, 1 : count + 1] + part * known[:, :count]


def is_added(name: str) -> bool:
    """True if a mechanism added the element; nobody commands such an actuator."""
    return name.startswith(ADDED)

"""What a mechanism is: a kind of effect, where it may be, and in which of three ways it acts."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector

Place = Literal["joint", "actuator", "body", "geom", "sensor", "global"]
# names of elements that mechanisms add
BRAKE, HOLD, RELEASE = "adr_brake_", "adr_force_", "adr_release_"


@dataclass(frozen=True)
class Strength:
    """One parameter of a mechanism; at zero it has no effect."""

    name: str
    unit: str
    low: float = -np.inf  # smallest value that makes sense


Change = Callable[[mujoco.MjModel, int, Vector], None]
Prepare = Callable[[mujoco.MjSpec, str], None]
Typical = Callable[[mujoco.MjModel, int], tuple[float, ...]]
Command = Callable[["Commands", int, Vector], Matrix]
Where = Callable[[mujoco.MjModel, int], bool]


@dataclass(frozen=True)
class Commands:
    """What an actuator was told, at every simulator step of every recorded episode."""

    values: Matrix  # (episodes, T) in units of control; after an episode's end, its last
    timestep: float  # [s]
    largest: float  # what the actuator obeys at most


@dataclass(frozen=True)
class Mechanism:
    """A kind of effect. Exactly one of `change`, `command` and `sense` says what it does."""

    kind: str
    place: Place
    strengths: tuple[Strength, ...]
    typical: Typical  # sizes that a sensible simulator might lack, of the strengths
    change: Change | None = None
    prepare: Prepare | None = None
    command: Command | None = None
    sense: Literal["bias", "scale", "delay", "backlash", "quantisation", "noise"] | None = None
    applies: Where = lambda model, element: True  # whether it makes sense at a place
    sizes: tuple[float, ...] = (1.0,)  # times typical, where effects are not in proportion
    has_sides: bool = False  # whether more and less of it are effects of their own
    includes: str = ""  # the kind that it is where its last strengths are zero

    @property
    def only_spreads(self) -> bool:
        """Whether it moves nothing on average; criticism looks for it in the readings alone."""
        return self.sense in ("quantisation", "noise")

    def locations(self, model: mujoco.MjModel) -> list[str]:
        """Where in a model the effect may be."""
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
    """The measured columns: positions, then velocities, by joint."""
    names = [model.joint(int(model.dof_jntid[dof])).name for dof in range(model.nv)]
    return [f"{n}.position" for n in names] + [f"{n}.velocity" for n in names]


def is_added(name: str) -> bool:
    """Whether an element is one that a mechanism added; nobody commands such an actuator."""
    return name.startswith((BRAKE, HOLD, RELEASE))

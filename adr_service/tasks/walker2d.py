"""Walker2d: walk forward on two legs in the plane, as fast as possible, without falling.

The benchmark's RandomWalker2d-v0 (Tiboni et al., random-envs), with the masses and inertias of
its simulator, MuJoCo 2.1.0; docs/tasks.md lists the differences and their reasons. Both legs share
their links' lengths, and a link's inertia is that of its capsule at the drawn length.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector, frozen
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks import planar
from adr_service.tasks.assets import read
from adr_service.tasks.base import Entry, State, Variant, benchmark_variants, freeze

if TYPE_CHECKING:  # MuJoCo takes a tenth of a second to import
    import mujoco

_TIMESTEP_S, _FRAME_SKIP = 0.002, 4
_LEG = ("thigh", "leg", "foot")
_LINKS = ("torso", *_LEG, *(f"{link}_left" for link in _LEG))
_LEG_MASSES_KG = (3.9269908169872427, 2.7143360527015816, 2.940530723760046)
_MASSES_KG = (3.534291735288517, *_LEG_MASSES_KG, *_LEG_MASSES_KG)
_LENGTHS_M = {"torso": 0.4, "thigh": 0.45, "leg": 0.6, "foot": 0.2}
_FRICTIONS = {"right": 0.9, "left": 1.9}
_ANKLE_M = 0.1  # height of the foot's axis; the leg's length is measured from the ground
_ROOT_M = 1.25  # height of the root's frame, whatever the lengths
_DENSITY = 1000.0  # kg/m^3


def _space(bounds: Mapping[str, tuple[float, float, float]]) -> ParameterSpace:
    """All thirteen parameters; `bounds` are low, high and feasible low of the lengths [m]."""
    masses = (Parameter(f"{link}_mass", f"body:{link}.mass", "kg", 0.5, 10, 0.1) for link in _LINKS)
    lengths = (
        Parameter(f"{link}_length", f"link:{link}.length", "m", *bounds[link])
        for link in _LENGTHS_M
    )
    frictions = (
        Parameter(f"{side}_friction", f"pair:{side}.friction", "1", 0.1, 3.0, 0.05)
        for side in _FRICTIONS
    )
    return ParameterSpace((*masses, *lengths, *frictions))


def _variants() -> Mapping[str, Variant]:
    truth = (*_MASSES_KG, *_LENGTHS_M.values(), *_FRICTIONS.values())
    free = (0.15, 1.0, 0.1)
    # random-envs allows 0.1 m for the leg too, at which its capsule has no length
    vanilla = _space({"torso": free, "thigh": free, "leg": (0.15, 1.0, 0.11), "foot": free})
    narrow = (0.3, 1.0, 0.25)
    unmodeled = freeze(
        _space({"torso": free, "thigh": narrow, "leg": narrow, "foot": (0.15, 0.8, 0.12)}),
        truth,
        ["torso_mass", "thigh_mass", "leg_mass", "torso_length"],
    )
    return benchmark_variants(vanilla, truth, 1e-3, unmodeled)


@dataclass(frozen=True)
class Walker2d:
    name: str = "walker2d"
    frame_skip: int = _FRAME_SKIP
    columns: tuple[str, ...] = planar.columns(_LINKS[1:])
    measured: int = 17
    derived: tuple[str, ...] = ()
    action_low: Vector = field(default_factory=lambda: frozen([-1.0] * 6))
    action_high: Vector = field(default_factory=lambda: frozen([1.0] * 6))
    horizon: int = 500
    reward_threshold: float = 2200.0
    learning_rate: float = 5e-4

    @property
    def xml(self) -> str:
        return read("walker2d.xml")

    def reshape(self, spec: "mujoco.MjSpec", lengths: Mapping[str, float]) -> None:
        """Set link lengths; the root's frame stays at 1.25 m, so z counts from the nominal pose."""
        torso, thigh, leg, foot = ({**_LENGTHS_M, **lengths}[link] for link in _LENGTHS_M)
        hip = thigh + leg - _ROOT_M  # in the torso's frame, as all below in their body's
        _capsule(spec, "torso", torso, [0, 0, hip + torso / 2])
        for side in ("", "_left"):
            shin = leg - _ANKLE_M
            spec.body(f"thigh{side}").pos = [0, 0, hip]
            _capsule(spec, f"thigh{side}", thigh, [0, 0, -thigh / 2])
            spec.body(f"leg{side}").pos = [0, 0, -thigh]
            _capsule(spec, f"leg{side}", shin, [0, 0, -shin / 2])
            spec.body(f"foot{side}").pos = [0, 0, -shin]
            _capsule(spec, f"foot{side}", foot, [foot / 2, 0, 0])

    def initial(self, n: int, rng: np.random.Generator) -> State:
        standing = np.array([0.0, _ROOT_M, *[0.0] * 7])
        qpos = standing + rng.uniform(-0.005, 0.005, (n, 9))
        return State(qpos, rng.uniform(-0.005, 0.005, (n, 9)))

    def observe(self, state: State) -> Matrix:
        return planar.observe(state)

    def state(self, observations: Matrix) -> State:
        return planar.at_origin(observations)

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        speed = planar.speed(before, after, _TIMESTEP_S * _FRAME_SKIP)
        return speed + 1.0 - 1e-3 * (action**2).sum(axis=1)

    def terminated(self, state: State) -> Mask:
        height, angle = state.qpos[:, 1], state.qpos[:, 2]
        return ~((height > 0.8) & (height < 2.0) & (np.abs(angle) < 1.0))


def _capsule(spec: "mujoco.MjSpec", link: str, length: float, centre: list[float]) -> None:
    """Give a link its capsule and the inertia that MuJoCo 2.1.0 derives from it, but no mass."""
    body, geom = spec.body(link), spec.geom(f"{link}_geom")
    radius = geom.size[0]
    geom.pos, geom.size = centre, [radius, length / 2, 0]
    cylinder = length + radius  # MuJoCo 2.1.0 treats a capsule as a cylinder of this length
    mass = _DENSITY * np.pi * radius**2 * cylinder
    across = mass * (3 * radius**2 + cylinder**2) / 12
    body.ipos, body.inertia = centre, [across, across, mass * radius**2 / 2]


ENTRY = Entry(Walker2d(), _variants())

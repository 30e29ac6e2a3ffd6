"""HalfCheetah: run forward on two legs in the plane, as fast as possible; it cannot fall.

The benchmark's RandomHalfCheetah-v0 (Tiboni et al., random-envs), with the masses and inertias
of its simulator, MuJoCo 2.1.0; docs/tasks.md lists the differences and their reasons.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector, frozen
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks import planar
from adr_service.tasks.assets import read
from adr_service.tasks.base import Entry, State, Variant, benchmark_variants, freeze

_TIMESTEP_S, _FRAME_SKIP = 0.01, 5
_LINKS = ("torso", "bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot")
_MASSES_KG = (
    6.360313315926893,
    1.5352480417754566,
    1.5809399477806787,
    1.0691906005221932,
    1.4255874673629243,
    1.178851174934726,
    0.8498694516971279,
)
_FRICTION = 0.4  # of both feet


def _space() -> ParameterSpace:
    masses = tuple(
        Parameter(f"{link}_mass", f"body:{link}.mass", "kg", 0.5, 10.0, 0.1) for link in _LINKS
    )
    return ParameterSpace((*masses, Parameter("friction", "pair:*.friction", "1", 0.1, 2.0, 0.02)))


def _variants() -> Mapping[str, Variant]:
    truth = (*_MASSES_KG, _FRICTION)
    unmodeled = freeze(_space(), truth, ["torso_mass", "bthigh_mass", "bshin_mass"])
    return benchmark_variants(_space(), truth, 1e-4, unmodeled)


@dataclass(frozen=True)
class HalfCheetah:
    name: str = "half_cheetah"
    frame_skip: int = _FRAME_SKIP
    columns: tuple[str, ...] = planar.columns(_LINKS[1:])
    measured: int = 17
    derived: tuple[str, ...] = ()
    action_low: Vector = field(default_factory=lambda: frozen([-1.0] * 6))
    action_high: Vector = field(default_factory=lambda: frozen([1.0] * 6))
    horizon: int = 500
    reward_threshold: float = 4500.0
    learning_rate: float = 5e-4

    @property
    def xml(self) -> str:
        return read("half_cheetah.xml")

    def initial(self, n: int, rng: np.random.Generator) -> State:
        return State(rng.uniform(-0.1, 0.1, (n, 9)), 0.1 * rng.standard_normal((n, 9)))

    def observe(self, state: State) -> Matrix:
        return planar.observe(state)

    def state(self, observations: Matrix) -> State:
        return planar.at_origin(observations)

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        speed = planar.speed(before, after, _TIMESTEP_S * _FRAME_SKIP)
        return speed - 0.1 * (action**2).sum(axis=1)

    def terminated(self, state: State) -> Mask:
        return np.zeros(len(state.qpos), dtype=np.bool_)


ENTRY = Entry(HalfCheetah(), _variants())

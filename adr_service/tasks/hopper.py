"""Hopper: hop forward on one leg, as fast as possible, without falling.

The benchmark's RandomHopper-v0 (Tiboni et al., random-envs), with the masses and inertias of
its simulator, MuJoCo 2.1.0; docs/tasks.md lists the differences and their reasons.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector, frozen
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks import planar
from adr_service.tasks.assets import read
from adr_service.tasks.base import Entry, State, Variant, benchmark_variants, freeze

_TIMESTEP_S, _FRAME_SKIP = 0.002, 4
_LINKS = ("torso", "thigh", "leg", "foot")
_MASSES_KG = (3.5342917352885173, 3.9269908169872414, 2.7143360527015816, 5.089380098815465)


def _space(feasible_low: float) -> ParameterSpace:
    return ParameterSpace(
        tuple(
            Parameter(f"{link}_mass", f"body:{link}.mass", "kg", 0.5, 10.0, feasible_low)
            for link in _LINKS
        )
    )


def _variants() -> Mapping[str, Variant]:
    unmodeled = freeze(_space(feasible_low=0.001), _MASSES_KG, ["torso_mass"])
    return benchmark_variants(_space(feasible_low=0.1), _MASSES_KG, 1e-4, unmodeled)


@dataclass(frozen=True)
class Hopper:
    name: str = "hopper"
    frame_skip: int = _FRAME_SKIP
    columns: tuple[str, ...] = planar.columns(_LINKS[1:])
    measured: int = 11
    derived: tuple[str, ...] = ()
    action_low: Vector = field(default_factory=lambda: frozen([-1.0] * 3))
    action_high: Vector = field(default_factory=lambda: frozen([1.0] * 3))
    horizon: int = 500
    reward_threshold: float = 1750.0
    learning_rate: float = 5e-4

    @property
    def xml(self) -> str:
        return read("hopper.xml")

    def initial(self, n: int, rng: np.random.Generator) -> State:
        standing = np.array([0.0, 1.25, 0.0, 0.0, 0.0, 0.0])
        qpos = standing + rng.uniform(-0.005, 0.005, (n, 6))
        return State(qpos, rng.uniform(-0.005, 0.005, (n, 6)))

    def observe(self, state: State) -> Matrix:
        return planar.observe(state)

    def state(self, observations: Matrix) -> State:
        return planar.at_origin(observations)

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        speed = planar.speed(before, after, _TIMESTEP_S * _FRAME_SKIP)
        return speed + 1.0 - 1e-3 * (action**2).sum(axis=1)

    def terminated(self, state: State) -> Mask:
        height, angle = state.qpos[:, 1], state.qpos[:, 2]
        # the published rule bounds the state without x and z
        bounded = (np.abs(state.qpos[:, 2:]) < 100).all(axis=1)
        bounded &= (np.abs(state.qvel) < 100).all(axis=1)
        return ~(bounded & (height > 0.7) & (np.abs(angle) < 0.2))


ENTRY = Entry(Hopper(), _variants())

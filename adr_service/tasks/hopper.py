"""Hopper: hop forward on one leg, as fast as possible, without falling.

The benchmark's RandomHopper-v0 (Tiboni et al., random-envs), with the masses and inertias of
its simulator, MuJoCo 2.1.0; docs/tasks.md lists what differs from it and why.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector, frozen
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.assets import read
from adr_service.tasks.base import Hidden, Source, State, Variant

_TIMESTEP_S, _FRAME_SKIP = 0.002, 4
_LINKS = ("torso", "thigh", "leg", "foot")
_MASSES_KG = (3.5342917352885173, 3.9269908169872414, 2.7143360527015816, 5.089380098815465)
_UNMODELED_FACTOR = 0.8  # of the torso's mass, in the source of the unmodeled variant


def _space(feasible_low: float) -> ParameterSpace:
    return ParameterSpace(
        tuple(
            Parameter(f"{link}_mass", f"body:{link}.mass", "kg", 0.5, 10.0, feasible_low)
            for link in _LINKS
        )
    )


def variants() -> Mapping[str, Variant]:
    source = Source(_space(feasible_low=0.1))
    truth = frozen(_MASSES_KG)
    three = _space(feasible_low=0.001).subset(("thigh_mass", "leg_mass", "foot_mass"))
    light = Source(three, {"body:torso.mass": _UNMODELED_FACTOR * _MASSES_KG[0]})
    return {
        "vanilla": Variant(source, Hidden(source, truth, 0.0)),
        "noisy": Variant(source, Hidden(source, truth, 1e-4)),
        "unmodeled": Variant(light, Hidden(source, truth, 0.0)),
    }


@dataclass(frozen=True)
class Hopper:
    name: str = "hopper"
    frame_skip: int = _FRAME_SKIP
    columns: tuple[str, ...] = (
        "z [m]",
        "torso_angle [rad]",
        "thigh_angle [rad]",
        "leg_angle [rad]",
        "foot_angle [rad]",
        "x_velocity [m/s]",
        "z_velocity [m/s]",
        "torso_velocity [rad/s]",
        "thigh_velocity [rad/s]",
        "leg_velocity [rad/s]",
        "foot_velocity [rad/s]",
    )
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
        return np.concatenate([state.qpos[:, 1:], state.qvel], axis=1)

    def state(self, observations: Matrix) -> State:
        """x is not observed; 0 is exact, because nothing depends on it but the reward."""
        x = np.zeros((len(observations), 1))
        return State(np.concatenate([x, observations[:, :5]], axis=1), observations[:, 5:])

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        velocity = (after.qpos[:, 0] - before.qpos[:, 0]) / (_TIMESTEP_S * _FRAME_SKIP)
        return velocity + 1.0 - 1e-3 * np.sum(action**2, axis=1)

    def terminated(self, state: State) -> Mask:
        height, angle = state.qpos[:, 1], state.qpos[:, 2]
        finite = np.all(np.isfinite(state.qpos), axis=1) & np.all(np.isfinite(state.qvel), axis=1)
        # the published rule bounds the state without x and z
        rest = np.concatenate([state.qpos[:, 2:], state.qvel], axis=1)
        with np.errstate(invalid="ignore"):
            bounded = np.all(np.abs(rest) < 100, axis=1)
            healthy = finite & bounded & (height > 0.7) & (np.abs(angle) < 0.2)
        return ~healthy

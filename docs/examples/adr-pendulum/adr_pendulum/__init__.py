"""Pendulum: swing up a rod and hold it, with a motor too weak to lift it at once."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources

import mujoco
import numpy as np

from adr_service.arrays import Mask, Matrix, Vector, frozen
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.base import Entry, State, benchmark_variants, freeze

_XML = resources.files("adr_pendulum").joinpath("pendulum.xml").read_text(encoding="utf-8")
_TRUTH = (1.2, 0.15, 0.9)


def _space() -> ParameterSpace:
    """Bounds of the distribution's mean, and the smallest value that can be simulated."""
    return ParameterSpace(
        (
            Parameter("mass", "body:rod.mass", "kg", 0.2, 3.0, 0.05),
            Parameter("friction", "joint:hinge.damping", "N m s/rad", 0.0, 1.0, 0.0),
            Parameter("length", "link:rod.length", "m", 0.3, 2.0, 0.1),
        )
    )


@dataclass(frozen=True)
class Pendulum:
    name: str = "pendulum"
    xml: str = _XML
    frame_skip: int = 2
    columns: tuple[str, ...] = ("cosine [1]", "sine [1]", "velocity [rad/s]")
    measured: int = 3  # sensors measure all columns
    derived: tuple[str, ...] = ()  # nothing else is needed of MuJoCo
    action_low: Vector = field(default_factory=lambda: frozen([-1.0]))
    action_high: Vector = field(default_factory=lambda: frozen([1.0]))
    horizon: int = 200
    reward_threshold: float = 120.0
    learning_rate: float = 1e-3

    def reshape(self, spec: mujoco.MjSpec, lengths: Mapping[str, float]) -> None:
        """A rod of this length, its inertia per mass that of a thin rod of one kilogram."""
        length, rod, geom = lengths.get("rod", 1.0), spec.body("rod"), spec.geom("rod")
        rod.ipos = geom.pos = [0, 0, -length / 2]
        geom.size = [0.03, length / 2, 0]
        rod.inertia = [length**2 / 12, length**2 / 12, 0.0005]

    def initial(self, n: int, rng: np.random.Generator) -> State:
        return State(rng.uniform(-0.2, 0.2, (n, 1)), rng.uniform(-0.1, 0.1, (n, 1)))

    def observe(self, state: State) -> Matrix:
        return np.concatenate([np.cos(state.qpos), np.sin(state.qpos), state.qvel], axis=1)

    def state(self, observations: Matrix) -> State:
        angle = np.arctan2(observations[:, 1:2], observations[:, :1])
        return State(angle, observations[:, 2:3])

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        """1 upright, 0 hanging."""
        return (1 - np.cos(after.qpos[:, 0])) / 2

    def terminated(self, state: State) -> Mask:
        return np.zeros(len(state.qpos), dtype=np.bool_)


ENTRY = Entry(
    Pendulum(),
    benchmark_variants(_space(), _TRUTH, 1e-4, unmodeled=freeze(_space(), _TRUTH, ["mass"])),
)

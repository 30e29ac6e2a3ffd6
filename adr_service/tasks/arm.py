"""Arm: lift the hand to a mark and hold it there, against gravity.

The small task of the demo and the tests, not one of the paper's. A policy trains in seconds. It
must know the masses that it holds up, because it sees no integral of its error.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector, frozen
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.assets import read
from adr_service.tasks.base import Entry, State, Variant, benchmark_variants, freeze

_LINK_M = 0.5
_MARK_M = (0.6, 0.4)  # x, z; as the site in the model
_REACH_M = 0.3  # distance at which the reward for being near falls to 1/e
_LIMIT_RAD = 3.5  # an episode ends where a joint turns further
_TRUTH = (1.0, 0.7, 2.0, 1.0)


def _space() -> ParameterSpace:
    return ParameterSpace(
        (
            Parameter("upper_mass", "body:upper.inertial", "kg", 0.2, 5.0, 0.1),
            Parameter("fore_mass", "body:fore.inertial", "kg", 0.2, 5.0, 0.1),
            Parameter("shoulder_friction", "joint:shoulder.damping", "N m s/rad", 0.0, 8.0, 0.0),
            Parameter("elbow_friction", "joint:elbow.damping", "N m s/rad", 0.0, 8.0, 0.0),
        )
    )


def _variants() -> Mapping[str, Variant]:
    return benchmark_variants(
        _space(), _TRUTH, 1e-4, unmodeled=freeze(_space(), _TRUTH, ["upper_mass"])
    )


@dataclass(frozen=True)
class Arm:
    name: str = "arm"
    frame_skip: int = 2
    columns: tuple[str, ...] = (
        "shoulder_angle [rad]",
        "elbow_angle [rad]",
        "shoulder_velocity [rad/s]",
        "elbow_velocity [rad/s]",
    )
    measured: int = 4
    derived: tuple[str, ...] = ()
    action_low: Vector = field(default_factory=lambda: frozen([-1.0, -1.0]))
    action_high: Vector = field(default_factory=lambda: frozen([1.0, 1.0]))
    horizon: int = 200
    reward_threshold: float = 165.0
    learning_rate: float = 1e-3

    @property
    def xml(self) -> str:
        return read("arm.xml")

    def initial(self, n: int, rng: np.random.Generator) -> State:
        """Hanging, nearly at rest."""
        return State(rng.uniform(-0.3, 0.3, (n, 2)), rng.uniform(-0.1, 0.1, (n, 2)))

    def observe(self, state: State) -> Matrix:
        return np.concatenate([state.qpos, state.qvel], axis=1)

    def state(self, observations: Matrix) -> State:
        return State(observations[:, :2], observations[:, 2:])

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        """In [0, 1]: most of it for being at the mark, a little for coming nearer."""
        distance = np.linalg.norm(self.hand(after) - _MARK_M, axis=1)
        near = np.exp(-((distance / _REACH_M) ** 2))
        return 0.2 * np.maximum(1 - distance / 1.7, 0) + 0.8 * near

    def terminated(self, state: State) -> Mask:
        return np.any(np.abs(state.qpos) >= _LIMIT_RAD, axis=1)

    def hand(self, state: State) -> Matrix:
        """Position of the hand, (n, 2): x and z [m]."""
        upper, fore = state.qpos[:, 0], state.qpos.sum(axis=1)
        x = _LINK_M * (np.sin(upper) + np.sin(fore))
        return np.column_stack([x, -_LINK_M * (np.cos(upper) + np.cos(fore))])


ENTRY = Entry(Arm(), _variants())

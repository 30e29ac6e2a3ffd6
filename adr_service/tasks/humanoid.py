"""Humanoid: walk forward on two legs, as fast as possible, without falling.

The benchmark's RandomHumanoid-v0 (Tiboni et al., random-envs), with the masses and inertias of
its simulator, MuJoCo 2.1.0; docs/tasks.md lists the differences and their reasons. Policies see 376
columns; sensors measure the first 45, positions and velocities, and inference uses only those.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector, frozen
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.assets import read
from adr_service.tasks.base import Entry, State, Variant, benchmark_variants, freeze

_TIMESTEP_S, _FRAME_SKIP = 0.003, 5
_MASSES_KG = {  # by body, in the model's order
    "torso": 8.322078939359361,
    "lwaist": 2.0357520395261854,
    "pelvis": 5.852787113637784,
    "right_thigh": 4.525556257747776,
    "right_shin": 2.6324944224829134,
    "right_foot": 1.7671458676442584,
    "left_thigh": 4.525556257747776,
    "left_shin": 2.6324944224829134,
    "left_foot": 1.7671458676442584,
    "right_upper_arm": 1.5940598415616258,
    "right_lower_arm": 1.1983431305833827,
    "left_upper_arm": 1.5940598415616258,
    "left_lower_arm": 1.1983431305833827,
}
_STIFF, _SOFT = 5.0, 1.0
_DAMPINGS = {  # by joint, in the model's order [N m s/rad]
    **dict.fromkeys(("abdomen_z", "abdomen_y", "abdomen_x"), _STIFF),
    **dict.fromkeys(("right_hip_x", "right_hip_z", "right_hip_y"), _STIFF),
    "right_knee": _SOFT,
    **dict.fromkeys(("left_hip_x", "left_hip_z", "left_hip_y"), _STIFF),
    "left_knee": _SOFT,
    **dict.fromkeys(("right_shoulder1", "right_shoulder2", "right_elbow"), _SOFT),
    **dict.fromkeys(("left_shoulder1", "left_shoulder2", "left_elbow"), _SOFT),
}
_DAMPING_BOUNDS = {_STIFF: (1.0, 10.0, 0.8), _SOFT: (0.2, 5.0, 0.15)}  # of each kind of joint

_BODIES, _MEASURED = 1 + len(_MASSES_KG), 45  # with the world
_COM_X = (10 + 6 + 6) * _BODIES + 23  # column of `derived`: x of the whole body's centre of mass


def _space() -> ParameterSpace:
    masses = (
        Parameter(f"{body}_mass", f"body:{body}.mass", "kg", 0.5, 10.0, 0.2) for body in _MASSES_KG
    )
    dampings = (
        Parameter(
            f"{joint}_damping", f"joint:{joint}.damping", "N m s/rad", *_DAMPING_BOUNDS[value]
        )
        for joint, value in _DAMPINGS.items()
    )
    return ParameterSpace((*masses, *dampings))


def _variants() -> Mapping[str, Variant]:
    truth = (*_MASSES_KG.values(), *_DAMPINGS.values())
    wrong = [f"{body}_mass" for body in ("torso", "lwaist", "pelvis", "right_thigh")]
    wrong += [f"abdomen_{axis}_damping" for axis in "zyx"]
    return benchmark_variants(_space(), truth, 1e-3, freeze(_space(), truth, wrong))


def _columns() -> tuple[str, ...]:
    joints, bodies = tuple(_DAMPINGS), ("world", *_MASSES_KG)
    rotations = ("roll", "pitch", "yaw")
    inertial = ("xx", "yy", "zz", "xy", "xz", "yz", "mx", "my", "mz", "m")
    motion = ("wx", "wy", "wz", "vx", "vy", "vz")
    freedoms = ("x", "y", "z", *rotations, *joints)
    return (
        "z [m]",
        *(f"orientation_{part} [1]" for part in "wxyz"),
        *(f"{joint}_angle [rad]" for joint in joints),
        *(f"{axis}_velocity [m/s]" for axis in "xyz"),
        *(f"{name}_velocity [rad/s]" for name in (*rotations, *joints)),
        *(f"{body}_inertia_{part} [SI]" for body in bodies for part in inertial),
        *(f"{body}_velocity_{part} [SI]" for body in bodies for part in motion),
        *(f"{freedom}_actuation [SI]" for freedom in freedoms),
        *(f"{body}_contact_{part} [SI]" for body in bodies for part in ("tx", "ty", "tz", *"xyz")),
    )


@dataclass(frozen=True)
class Humanoid:
    name: str = "humanoid"
    frame_skip: int = _FRAME_SKIP
    columns: tuple[str, ...] = _columns()
    measured: int = _MEASURED
    derived: tuple[str, ...] = ("cinert", "cvel", "qfrc_actuator", "cfrc_ext", "subtree_com")
    action_low: Vector = field(default_factory=lambda: frozen([-0.4] * 17))
    action_high: Vector = field(default_factory=lambda: frozen([0.4] * 17))
    horizon: int = 500
    reward_threshold: float = 2200.0
    learning_rate: float = 1e-4

    @property
    def xml(self) -> str:
        return read("humanoid.xml")

    def initial(self, n: int, rng: np.random.Generator) -> State:
        standing = np.array([0.0, 0.0, 1.4, 1.0, *[0.0] * 20])
        qpos = standing + rng.uniform(-0.01, 0.01, (n, 24))
        return State(_with_unit_quaternion(qpos), rng.uniform(-0.01, 0.01, (n, 23)))

    def observe(self, state: State) -> Matrix:
        """Contact forces (`cfrc_ext`) are zero: neither MuJoCo 2.1.0 nor the batch fills them."""
        return np.concatenate([state.qpos[:, 2:], state.qvel, state.derived[:, :_COM_X]], axis=1)

    def state(self, observations: Matrix) -> State:
        """The state at the origin, with the orientation normalised as the simulator does."""
        origin = np.zeros((len(observations), 2))
        qpos = np.concatenate([origin, observations[:, :22]], axis=1)
        return State(_with_unit_quaternion(qpos), observations[:, 22:_MEASURED])

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        """From the centre of mass's speed; without the impact cost, as contact forces are zero."""
        travel = after.derived[:, _COM_X] - before.derived[:, _COM_X]
        speed = travel / (_TIMESTEP_S * _FRAME_SKIP)
        return 1.25 * speed + 5.0 - 0.1 * (action**2).sum(axis=1)

    def terminated(self, state: State) -> Mask:
        height = state.qpos[:, 2]
        return ~((height >= 1.0) & (height <= 2.0))


def _with_unit_quaternion(qpos: Matrix) -> Matrix:
    unit = qpos.copy()
    unit[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    return unit


ENTRY = Entry(Humanoid(), _variants())

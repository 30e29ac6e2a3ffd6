"""A plan of the next recording, and its file.

Path("next.npz").write_bytes(plan.to_npz())
commands, start = read_plan(content, width=2, period=0.02)
"""

from dataclasses import dataclass

import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.measurements import Measurement
from adr_service.errors import InvalidInput
from adr_service.npz import read_arrays, write_arrays

_PLANNED = ("time", "ctrl", "episode")
_START = "qpos0"


@dataclass(frozen=True)
class Separation:
    """Evidence to expect from both recordings together, to first order."""

    named: str
    other: str
    if_named: float  # nats to expect if the named cause is true
    # the same if the other is true. If one can do all that the other does, only its own truth shows
    if_other: float

    @property
    def is_expected(self) -> bool:
        """True if one of the two can be told from the other."""
        return max(self.if_named, self.if_other) >= THRESHOLD


@dataclass(frozen=True)
class Plan:
    """Commands of the next recording, open loop."""

    commands: Array3  # (episodes, rows, nu)
    period: float  # [s] that each command holds
    separations: tuple[Separation, ...]
    # effects that could be seen in both recordings together, and not in the one that there is;
    # known where nothing is tied
    newly_shown: tuple[str, ...]
    start: Vector | None  # (nq,) pose at rest of each episode; None: as recorded episodes begin
    reach: Matrix  # (nq, 2) smallest and largest positions in simulation, with what is named
    recorded: Matrix  # (nq, 2) the same of the recording that there is

    def to_npz(self) -> bytes:
        """An `.npz` of `time` (N,), `ctrl` (N, nu) and `episode` (N,), as in a measurement.

        With a pose to start from, it has `qpos0` (nq,).
        """
        episodes, rows, width = self.commands.shape
        time = np.tile(self.period * np.arange(rows), episodes)
        number = np.repeat(np.arange(episodes), rows)
        ctrl = self.commands.reshape(-1, width)
        pose = {} if self.start is None else {_START: self.start}
        return write_arrays({"time": time, "ctrl": ctrl, "episode": number, **pose})


def read_plan(content: bytes, width: int, period: float) -> tuple[list[Matrix], Vector | None]:
    """The commands (rows, nu) of each episode of a plan's `.npz`, and the pose to start from.

    Raises InvalidInput unless each holds for `period` seconds and they are for `width` actuators.
    """
    arrays = read_arrays(content, (*_PLANNED, _START))
    if missing := [name for name in _PLANNED if name not in arrays]:
        raise InvalidInput(f"the plan lacks {missing}; `adr criticise --next` writes one")
    time, ctrl, episode = (arrays[name] for name in _PLANNED)
    if ctrl.dtype.kind not in "iuf" or ctrl.ndim != 2 or ctrl.shape[1] != width:
        raise InvalidInput(
            f"the plan's commands are {ctrl.dtype} of shape {ctrl.shape}; expected are numbers of "
            f"shape (rows, {width})"
        )
    # a plan is a measurement of a robot without joints
    empty = np.empty((len(ctrl), 0))
    plan = Measurement(time=time, qpos=empty, qvel=empty, ctrl=ctrl, episode=episode)
    if abs(plan.period() - period) > 1e-3 * period:
        raise InvalidInput(
            f"the plan's commands hold for {plan.period():g} s; the robot's hold for {period:g} s"
        )
    start = arrays.get(_START)
    if start is not None and not _is_pose(start):
        raise InvalidInput(
            f"the plan's {_START} is {start.dtype} of shape {start.shape}; expected is a finite "
            "position of each joint"
        )
    return [plan.ctrl[first:last] for first, last in plan.spans()], start


def _is_pose(start: np.ndarray) -> bool:
    return start.dtype.kind == "f" and start.ndim == 1 and bool(np.all(np.isfinite(start)))

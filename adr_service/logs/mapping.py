"""A map in TOML from the columns of a log to the joints and commands of a model.

[time]
column = "stamp"          # times of the rows; "time" if left out. Bags have their own
unit = "ms"               # s, ms, us or ns
# nanoseconds = "nanosec" # the column to add, where the other has whole seconds (unit = "s")

[rows]
period = 0.01             # seconds between rows of the measurement
seconds = 1.0             # length of the episodes that it is cut into
episode = "trial"         # a column that changes where another recording begins

[joints.shoulder]         # every joint of the model
position = "q1"           # its column
unit = "deg"              # rad, deg, rev; or m, cm, mm for a slide
scale = -1.0              # position in the model = scale × (reading - zero)
zero = 90.0
wrap = 360.0              # of readings that start again at the end of a turn: the size of a turn
velocity = "dq1"          # without a velocity, it counts as not measured
velocity_unit = "rpm"     # the position's unit per second, if left out
velocity_scale = -1.0     # the position's scale, if left out
derive_velocity = false   # true: take the slope of the positions, for a smooth motion alone

[actuators.motor]         # every actuator of the model
command = "current_1"     # or constant = 0.0 for one that was off
scale = 0.45              # command of the model = scale × (reading - zero)
zero = 0.0
unit = "deg"              # of a set-point that is a position
wrap = 360.0              # of set-points that start again, or whose joint's readings do
delay = 0.0               # seconds from the command's stamp to when the robot obeys; negative, if
                          # the stamp is of an arrival that is later
between = "hold"          # until the next reading; or "line": straight, for fast commands
"""

import tomllib
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, Self

import mujoco
import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator

from adr_service.criticism.compatibility import commanded_actuators, joints_of
from adr_service.errors import InvalidInput, UnknownName
from adr_service.json_values import Wire, message_of
from adr_service.logs.base import Clock, TimeUnit

PositionUnit = Literal["rad", "deg", "rev", "m", "cm", "mm"]
VelocityUnit = Literal["rad/s", "deg/s", "rev/s", "rpm", "m/s", "cm/s", "mm/s"]
ANGLES = {"rad": 1.0, "deg": np.pi / 180, "rev": 2 * np.pi}
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_RATES = {
    **{f"{unit}/s": size for unit, size in {**ANGLES, **LENGTHS}.items()},
    "rpm": 2 * np.pi / 60,
}


def _not_zero(factor: float) -> float:
    if factor == 0:
        raise ValueError("a scale of 0 makes all readings zero; given 0")
    return factor


Scale = Annotated[float, AfterValidator(_not_zero)]


class TimeMap(Wire):
    column: str = "time"
    unit: TimeUnit = "s"
    nanoseconds: str | None = Field(
        default=None, description="column to add to one of whole seconds"
    )

    @model_validator(mode="after")
    def _whole_seconds(self) -> Self:
        if self.nanoseconds is not None and self.unit != "s":
            raise ValueError(f"nanoseconds go with a column of unit 's'; given {self.unit!r}")
        return self

    @property
    def clock(self) -> Clock:
        return Clock(self.column, self.unit, self.nanoseconds)


class RowsMap(Wire):
    period: float | None = Field(None, gt=0, description="seconds between rows")
    seconds: float = Field(1.0, gt=0, description="length of an episode")
    episode: str | None = Field(None, description="column that changes between recordings")


class JointMap(Wire):
    position: str
    unit: PositionUnit | None = Field(None, description="rad or m, if left out")
    scale: Scale = 1.0
    zero: float = 0.0
    wrap: float | None = Field(None, gt=0, description="size of a turn, of readings that wrap")
    velocity: str | None = None
    velocity_unit: VelocityUnit | None = Field(None, description="unit/s, if left out")
    velocity_scale: Scale | None = Field(None, description="as `scale`, if left out")
    derive_velocity: bool = Field(False, description="from positions, for smooth motion")

    @model_validator(mode="after")
    def _one_velocity(self) -> Self:
        if self.velocity is not None and self.derive_velocity:
            raise ValueError("give either velocity or derive_velocity, not both")
        return self

    @property
    def has_velocity(self) -> bool:
        """True if a velocity counts as measured."""
        return self.velocity is not None or self.derive_velocity

    def position_factor(self, is_slide: bool) -> float:
        """SI units of the model in one unit of the reading."""
        return self.scale * self._size(is_slide)

    def velocity_factor(self, is_slide: bool) -> float:
        size = self._size(is_slide) if self.velocity_unit is None else _RATES[self.velocity_unit]
        return size * (self.scale if self.velocity_scale is None else self.velocity_scale)

    def check(self, name: str, is_slide: bool) -> None:
        """Raises InvalidInput for units of angles at a slide, or of lengths at a hinge."""
        unit = (
            "rpm" if self.velocity_unit == "rpm" else (self.velocity_unit or "").removesuffix("/s")
        )
        for given in (self.unit, unit):
            if given and not (given == "rpm" and not is_slide):
                _check_unit(f"joints.{name}", given, is_slide)

    def _size(self, is_slide: bool) -> float:
        known = LENGTHS if is_slide else ANGLES
        return known[self.unit] if self.unit else 1.0


def _check_unit(field: str, given: str, is_slide: bool) -> None:
    known, kind = (LENGTHS, "a slide") if is_slide else (ANGLES, "a hinge")
    if given not in known:
        raise InvalidInput(
            f"{field}: the joint is {kind}, whose units are {', '.join(known)}; given {given!r}"
        )


class ActuatorMap(Wire):
    command: str | None = None
    constant: float | None = Field(None, description="of an actuator that the log lacks")
    unit: PositionUnit | None = Field(None, description="of a set-point that is a position")
    scale: Scale = 1.0
    zero: float = 0.0
    wrap: float | None = Field(None, gt=0, description="size of a turn, of a set-point")
    delay: float = Field(0.0, description="seconds until the robot obeys")
    between: Literal["hold", "line"] = Field("hold", description="readings of the command")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.command is None) == (self.constant is None):
            raise ValueError("give either command, a column, or constant, a number")
        if self.constant is not None and len(self.model_fields_set) > 1:
            others = ", ".join(sorted(self.model_fields_set - {"constant"}))
            raise ValueError(f"constant is in the model's own unit, and goes without {others}")
        return self

    @property
    def factor(self) -> float:
        return self.scale * (1.0 if self.unit is None else {**ANGLES, **LENGTHS}[self.unit])


class LogMap(Wire):
    """Map from the columns of a log to the quantities of a model."""

    time: TimeMap = TimeMap()
    rows: RowsMap = Field(default_factory=lambda: RowsMap.model_validate({}))
    joints: dict[str, JointMap]
    actuators: dict[str, ActuatorMap] = Field(default_factory=dict[str, ActuatorMap])

    @classmethod
    def from_toml(cls, text: str) -> "LogMap":
        """Raises InvalidInput with the field that is wrong, and what is accepted."""
        try:
            return cls.model_validate(tomllib.loads(text))
        except tomllib.TOMLDecodeError as error:
            raise InvalidInput(f"the map is no TOML: {error}") from error
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"]) or "the map"
            raise InvalidInput(f"the map, {place}: {message_of(first)}") from error

    def check(self, model: mujoco.MjModel) -> None:
        """Raises InvalidInput unless the map has all joints and actuators of a model, no more."""
        _check_names("joint", self.joints, joints_of(model))
        _check_names("actuator", self.actuators, commanded_actuators(model))
        for name, joint in self.joints.items():
            joint.check(name, is_slide(model, name))
        for name, drive in self.actuators.items():
            _check_set_point(name, drive, model)
            self._check_wrap(name, drive, model)

    def _check_wrap(self, name: str, drive: ActuatorMap, model: mujoco.MjModel) -> None:
        """Raises InvalidInput for a set-point that cannot be put next to its joint."""
        joint = joint_of(model, name)
        turns = joint is not None and self.joints[joint].wrap is not None
        if drive.wrap is not None and not turns:
            raise InvalidInput(
                f"actuators.{name}.wrap is for a set-point of a joint whose readings wrap; "
                f"{'it moves no joint' if joint is None else f'give joints.{joint} a wrap as well'}"
            )
        if drive.wrap is not None and not is_servo(model, name):
            raise InvalidInput(
                f"actuators.{name}.wrap is for a set-point; its command is no position of "
                f"joints.{joint}. Remove it"
            )
        if turns and drive.wrap is None and drive.command is not None and is_servo(model, name):
            raise InvalidInput(
                f"the readings of joints.{joint} wrap, so actuators.{name}, whose command is a "
                "position of that joint, needs a wrap as well: the size of a turn in the "
                "command's own unit, by which it is put next to the joint"
            )


def _check_set_point(name: str, drive: ActuatorMap, model: mujoco.MjModel) -> None:
    """Raises InvalidInput for the unit of a position that a command is not, or not in its kind."""
    if drive.unit is None:
        return
    joint = joint_of(model, name)
    if joint is None or not is_servo(model, name):
        raise InvalidInput(
            f"actuators.{name}.unit is for a set-point that is a joint's position; this command is "
            "in the actuator's own unit, to which `scale` brings it"
        )
    _check_unit(f"actuators.{name}", drive.unit, is_slide(model, joint))


def joint_of(model: mujoco.MjModel, actuator: str) -> str | None:
    """The joint that an actuator moves, None if it moves something else."""
    drive = model.actuator(actuator)
    is_at_joint = drive.trntype[0] == mujoco.mjtTrn.mjTRN_JOINT
    return model.joint(int(drive.trnid[0])).name if is_at_joint else None


def is_servo(model: mujoco.MjModel, actuator: str) -> bool:
    """True if a command is a position: the force depends on where the joint is."""
    return bool(model.actuator(actuator).biasprm[1] != 0)


def is_slide(model: mujoco.MjModel, joint: str) -> bool:
    return bool(model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE)


def _check_names(what: str, given: Mapping[str, object], expected: Sequence[str]) -> None:
    for name in given:
        if name not in expected:
            raise UnknownName(f"{what} of the model", name, expected)
    if missing := [name for name in expected if name not in given]:
        raise InvalidInput(
            f"the map lacks {what}s of the model: {', '.join(missing)}; every {what} needs a table "
            f"[{what}s.{missing[0]}]. A joint that stays put can be deleted in the model, with its "
            "actuators: that welds its body at the pose of the file"
        )

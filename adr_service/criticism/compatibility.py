"""Checks that a measurement and a model fit together, and that the criticism fits in memory."""

import mujoco
import numpy as np

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.plausibility import check_rates, check_usable
from adr_service.effects.base import is_added
from adr_service.effects.catalogue import MECHANISMS
from adr_service.errors import InvalidInput

_MOST_STEPS = 500  # of the simulator between two rows
_MOST_NUMBERS = 5e8  # that are kept at a time: 4 GB
_REMEMBERING = mujoco.mjtEnableBit.mjENBL_SLEEP | mujoco.mjtEnableBit.mjENBL_IPC


def check_measurement(nominal: Nominal, data: Measurement) -> None:
    """Raises InvalidInput if the data are too few, or do not belong to the simulator."""
    model = nominal.model(nominal.start)
    check_columns(model, data)
    check_usable(data)
    check_rates(data)
    check_size(model, data, 2 * model.nv * _tried_strengths(model))


def check_size(model: mujoco.MjModel, data: Measurement, kept: int) -> None:
    """Raises InvalidInput if the data would take too much memory.

    `kept`: how many numbers are kept of each transition; episodes are padded to the longest.
    """
    steps = steps_between(data.period(), model.opt.timestep)
    lengths = [last - first for first, last in data.spans()]
    needed = max(len(lengths) * max(lengths) * kept, len(data.time) * steps * 2 * model.nv)
    if needed > _MOST_NUMBERS:
        raise InvalidInput(
            f"{len(lengths)} episodes, the longest of {max(lengths)} rows, with {steps} steps of "
            f"the model between rows, would take {needed:.2g} numbers at a time; accepted are "
            f"{_MOST_NUMBERS:.2g} (give fewer rows, in episodes of about the same length)"
        )


def _tried_strengths(model: mujoco.MjModel) -> int:
    """Number of strengths whose responses a scan keeps: of all effects, at all places and sizes."""
    return sum(
        len(mechanism.locations(model)) * mechanism.tries * len(mechanism.strengths)
        for mechanism in MECHANISMS.values()
        if not mechanism.only_spreads
    )


def check_state(model: mujoco.MjModel) -> None:
    """Raises InvalidInput unless the state is positions and velocities of slides and hinges."""
    if model.nq != model.nv:
        raise InvalidInput(
            f"the model has {model.nq} positions for {model.nv} velocities: free and ball joints "
            "are not supported; accepted are slides and hinges"
        )
    if not model.nv:
        raise InvalidInput("the model has no joints; needed is at least one slide or hinge")
    if np.any(model.actuator_ctrlnum != 1):
        raise InvalidInput(
            f"the model's actuators have {model.actuator_ctrlnum.tolist()} commands; accepted are "
            "actuators of one command each"
        )
    if model.opt.enableflags & _REMEMBERING:
        raise InvalidInput(
            "the model has the flag 'sleep' or 'ipc', which keep more than positions and "
            "velocities from step to step; take it out of the model's options"
        )
    beyond = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS) - 1 - 2 * model.nv
    if beyond:
        raise InvalidInput(
            f"the model's state has {beyond} numbers besides positions and velocities, which "
            "nobody measured; accepted are actuators without dynamics or delay (both are among "
            "the causes), and springs that do not yield"
        )


def joints_of(model: mujoco.MjModel) -> list[str]:
    """Names of the joints, in the model's order."""
    return [model.joint(i).name for i in range(model.njnt)]


def commanded_actuators(model: mujoco.MjModel) -> list[str]:
    """Names of the actuators whose commands a measurement has. Those that a mechanism added come
    last in the model, and are left out."""
    names = [model.actuator(i).name for i in range(model.nu)]
    return [name for name in names if not is_added(name)]


def check_columns(model: mujoco.MjModel, data: Measurement) -> None:
    """Raises InvalidInput unless the data have the model's whole state and all its commands."""
    check_state(model)
    if data.ctrl_within is not None:
        parts, steps = data.ctrl_within.shape[1], steps_between(data.period(), model.opt.timestep)
        if steps % parts:
            raise InvalidInput(
                f"ctrl_within has {parts} parts in a row, which are no whole number of the model's "
                f"{steps} steps between rows; accepted are {_divisors(steps)}"
            )
    joints, drives = joints_of(model), commanded_actuators(model)
    for name, expected in {"qpos": joints, "qvel": joints, "ctrl": drives}.items():
        if (given := getattr(data, name).shape[1]) != len(expected):
            raise InvalidInput(
                f"{name} has {_columns(given)}; the model needs {_columns(len(expected))}"
                + (f", for {', '.join(expected)}" if expected else "")
            )


def _columns(count: int) -> str:
    return "1 column" if count == 1 else f"{count} columns"


def _divisors(steps: int) -> str:
    return ", ".join(str(k) for k in range(1, steps + 1) if steps % k == 0)


def steps_between(period: float, timestep: float) -> int:
    """Simulator steps between two rows; raises InvalidInput unless they are a whole number."""
    steps = period / timestep
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-3 * steps:
        raise InvalidInput(
            f"rows are {period:g} s apart, which is no multiple of the model's step of "
            f"{timestep:g} s"
        )
    if steps > _MOST_STEPS:
        raise InvalidInput(
            f"rows are {period:g} s apart, {round(steps)} of the model's steps; accepted are "
            f"{_MOST_STEPS} at most (is `time` in seconds?)"
        )
    return round(steps)

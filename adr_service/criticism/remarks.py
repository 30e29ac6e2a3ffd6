"""Remarks of a verdict on the data, in sentences."""

from collections.abc import Sequence

import mujoco
import numpy as np

from adr_service.criticism.measurements import Measurement
from adr_service.effects.base import Effect


def on_commands(model: mujoco.MjModel, data: Measurement) -> tuple[str, ...]:
    """Remarks on commands that never change, or that are beyond an actuator's limits."""
    commands = data.ctrl[:-1][np.diff(data.episode) == 0]  # an episode's last row commands nothing
    remarks: list[str] = []
    for number, values in enumerate(commands.T):
        name = model.actuator(number).name
        if np.ptp(values) == 0:
            remarks.append(
                f"The command to actuator {name} is {values[0]:g} all the time: these data cannot "
                "show what it does with other commands."
            )
        low, high = model.actuator_ctrlrange[number]
        beyond = int(np.sum((values < low) | (values > high)))
        if model.actuator_ctrllimited[number] and beyond:
            remarks.append(
                f"{beyond} of {len(values)} commands to actuator {name} are beyond its limits, "
                f"{low:g} to {high:g}; the simulator obeys the limits, as MuJoCo does."
            )
    return tuple(remarks)


def on_refuted(effects: Sequence[Effect]) -> str:
    """A remark on effects that the sealed episodes refute."""
    names = ", ".join(f"{effect.kind} {effect.location}" for effect in effects)
    return (
        f"Three quarters of the episodes have evidence for {names}, but the others, which were "
        "opened last, are predicted worse with it; so it is not named. Do episodes differ in "
        "something that is not recorded?"
    )

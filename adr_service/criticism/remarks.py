"""Remarks of a verdict on the data and on what it names, in sentences."""

from collections.abc import Sequence
from copy import copy

import mujoco
import numpy as np

from adr_service.criticism.linear import Persistence
from adr_service.criticism.measurements import Measurement
from adr_service.effects.actuators import obeys_limits
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import MECHANISMS, get_mechanism
from adr_service.effects.models import plausible_of, unit_of

_ROUNDING = 1e-6  # of a range of commands
_IMPLAUSIBLE = 2.0  # deviations of a strength among robots


def on_commands(model: mujoco.MjModel, data: Measurement) -> tuple[str, ...]:
    """Remarks on commands that never change, or that are beyond an actuator's limits."""
    within = data.ctrl[:, None] if data.ctrl_within is None else data.ctrl_within
    commands = within[:-1][np.diff(data.episode) == 0]  # an episode's last row commands nothing
    is_limited = obeys_limits(model)
    remarks: list[str] = []
    for number in range(commands.shape[2]):
        values = commands[..., number]
        name = model.actuator(number).name
        if np.ptp(values) == 0:
            remarks.append(
                f"The command to actuator {name} is {values[0, 0]:g} all the time: these data "
                "cannot show what it does with other commands."
            )
        low, high = model.actuator_ctrlrange[number]
        slack = _ROUNDING * (high - low)
        beyond = int(np.any((values < low - slack) | (values > high + slack), axis=1).sum())
        if is_limited[number] and beyond:
            remarks.append(
                f"{beyond} of {len(values)} commands to actuator {name} are beyond its limits, "
                f"{low:g} to {high:g}; the simulator obeys the limits, as MuJoCo does."
            )
    return tuple(remarks)


def on_diverging(timestep: float, finer: int) -> str:
    """A remark on a model that can be simulated in steps alone that are so much finer."""
    return (
        f"The simulation diverges in the model's own timestep of {timestep:g} s. It was judged in "
        f"one of {timestep / finer:.3g} s: give the model that one, extended.xml as well."
    )


def on_untried(model: mujoco.MjModel) -> tuple[str, ...]:
    """A remark on effects that some joints rule out, because they limit their actuators' force."""
    limited = [model.joint(i).name for i in np.flatnonzero(model.jnt_actfrclimited)]
    if not limited:
        return ()
    unlimited = copy(model)
    unlimited.jnt_actfrclimited[:] = 0
    lost: list[str] = []
    for kind, mechanism in MECHANISMS.items():
        left, possible = mechanism.locations(model), mechanism.locations(unlimited)
        if left != possible:
            lost.append(f"{kind} there" if left else f"{kind} at any {mechanism.place}")
    are_several = len(limited) > 1
    who = f"joint{'s' * are_several} {', '.join(limited)} limit{'s' * (not are_several)}"
    return (
        f"Not tried, because {who} the total force of actuators "
        f"(actuatorfrcrange), and MuJoCo would cut these effects too: {', '.join(lost)}.",
    )


def on_unwritable(reason: str) -> str:
    """A remark on an extended model that has no files."""
    return f"There are no extended.xml and effects.json: {reason}."


def on_unknown() -> str:
    """A remark for readers who would look for unknown physics first."""
    return (
        "Before you look for physics: a wrong sign, unit, gain or time of a column looks like a "
        "force that nobody knows. Check the map of the log, and what `adr measure` pointed out "
        "(docs/logs.md); then whether a free parameter has too narrow bounds."
    )


def on_refuted(effects: Sequence[Effect]) -> str:
    """A remark on effects that the sealed episodes refute."""
    names = ", ".join(f"{effect.kind} {effect.location}" for effect in effects)
    return (
        f"Three quarters of the episodes have evidence for {names}, but the others, which were "
        "opened last, are predicted worse with it; so it is not named. Do episodes differ in "
        "something that is not recorded?"
    )


def on_undetermined(effects: Sequence[Effect]) -> tuple[str, ...]:
    """A remark on effects whose strengths may be zero, though predictions are better with them."""
    if not effects:
        return ()
    names = ", ".join(f"{effect.kind} {effect.location}" for effect in effects)
    return (
        f"Episodes are predicted better with {names}, but at 95 % the strengths may all be zero, "
        "so none of these is named: give more episodes, or free fewer parameters.",
    )


def on_persistence(persistence: Persistence) -> tuple[str, ...]:
    """A remark where a transition passes on some of its misfit."""
    if persistence.share == 0:
        return ()
    return (
        f"What is left after a control step passes about {persistence.share:g} of itself on to the "
        "next one: forces act that nobody recorded, or that none of the effects explains.",
    )


def on_implausible(model: mujoco.MjModel, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Remarks on strengths that hardly any robot has and a model lacks."""
    remarks: list[str] = []
    for effect in effects:
        likely = plausible_of(model, effect)
        strengths = get_mechanism(effect.kind).strengths
        for strength, value, usual in zip(strengths, effect.values, likely, strict=True):
            if abs(value) > _IMPLAUSIBLE * usual and not strength.is_shape:
                unit = unit_of(model, effect.location, strength.unit)
                remarks.append(
                    f"{effect.kind} {effect.location} needs a {strength.name} of {value:.3g} "
                    f"{unit}, more than {_IMPLAUSIBLE:g} times the {usual:.2g} {unit} that a robot "
                    "may have: a unit may be wrong, or it stands in for a gross error of the model."
                )
    return tuple(remarks)

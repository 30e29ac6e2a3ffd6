"""Effects on signals: commands on their way to actuators, readings on their way from sensors.

    obeyed(model, effects, commands, timestep)      # what the actuators do
    shown(model, effects, states, rates, past)      # what the sensors show of true states
    behind(model, effects, states, rates, past)     # true states behind what the sensors show

Effects act in their order, and are undone in the opposite one.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from adr_service.arrays import Array3, Matrix, Vector
from adr_service.effects.actuators import obeys_limits
from adr_service.effects.base import Commands, Effect, Motion, Past, Sensing, delayed
from adr_service.effects.catalogue import get_mechanism
from adr_service.effects.models import element_of
from adr_service.errors import InvalidInput


def obeyed(
    model: mujoco.MjModel, effects: Sequence[Effect], commands: Array3, timestep: float
) -> Array3:
    """Commands (episodes, T, nu) as actuators with effects obey them; `timestep` [s] apart."""
    changed = commands.copy()
    for effect in effects:
        command = get_mechanism(effect.kind).command
        if command is None:
            continue
        actuator = element_of(model, effect.location)
        given = Commands(changed[:, :, actuator], timestep, _largest(model, actuator))
        changed[:, :, actuator] = command(given, np.array(effect.values))
    return changed


def acts_on_commands(effects: Sequence[Effect]) -> bool:
    """True if some effect changes commands."""
    return any(get_mechanism(effect.kind).command is not None for effect in effects)


def _largest(model: mujoco.MjModel, actuator: int) -> float:
    is_limited = obeys_limits(model)[actuator]
    return float(np.abs(model.actuator_ctrlrange[actuator]).max()) if is_limited else np.inf


def windows(model: mujoco.MjModel, effects: Sequence[Effect]) -> dict[int, float]:
    """Seconds up to a moment over which effects in sensors need the rate of a velocity, by its
    column. A position's rate is its velocity, which the states have."""
    return {
        column: sensing.window(np.array(effect.values))
        for effect, sensing in _in_sensors(effects)
        if sensing.window is not None
        for column in sensing.columns(model, element_of(model, effect.location))
        if column >= model.nq
    }


def rates_at_ends(paths: Array3, timestep: float, over: Mapping[int, float]) -> Matrix:
    """(n, 2 nv) rates of change [1/s] at the ends of paths (n, k + 1, 2 nv) of states that are
    `timestep` apart: over the last step, or over so many seconds of a column, but no less than
    that step and no more than the path."""
    rates = (paths[:, -1] - paths[:, -2]) / timestep
    for column, window in over.items():
        path = paths[..., column]
        steps = min(max(window / timestep, 1.0), path.shape[1] - 1.0)
        rates[:, column] = (path - delayed(path, steps))[:, -1] / (steps * timestep)
    return rates


def shown(
    model: mujoco.MjModel, effects: Sequence[Effect], states: Matrix, rates: Matrix, past: Past
) -> Matrix:
    """Readings (n, 2 nv) of true states that change by `rates` [1/s] and have come a way, of each
    position, that `past` gives."""
    readings = states.copy()
    for effect, _ in _in_sensors(effects):
        for column, offset in offsets_of(model, effect, readings, rates, past).items():
            readings[:, column] += offset
    return readings


def behind(
    model: mujoco.MjModel, effects: Sequence[Effect], states: Matrix, rates: Matrix, past: Past
) -> Matrix:
    """True states (n, 2 nv) behind readings that change by `rates` [1/s], with a `past`."""
    true = states.copy()
    for effect, sensing in reversed(_in_sensors(effects)):
        offset = sensing.offset_shown or sensing.offset
        for column in sensing.columns(model, element_of(model, effect.location)):
            motion = _motion(sensing, true, rates, column, past)
            true[:, column] -= offset(motion, np.array(effect.values))
    return true


def offsets_of(
    model: mujoco.MjModel, effect: Effect, states: Matrix, rates: Matrix, past: Past
) -> dict[int, Vector]:
    """Offsets (n,) that an effect in a sensor adds to readings of true states, by column; `states`
    as the effects before it leave them."""
    sensing = get_mechanism(effect.kind).sensing
    if sensing is None:
        raise InvalidInput(f"{effect.kind} is not in a sensor")
    values = np.array(effect.values)
    return {
        column: sensing.offset(_motion(sensing, states, rates, column, past), values)
        for column in sensing.columns(model, element_of(model, effect.location))
    }


def _motion(sensing: Sensing, states: Matrix, rates: Matrix, column: int, past: Past) -> Motion:
    known = past(column) if sensing.uses_past else np.empty((len(states), 0))
    return Motion(states, rates, column, known)


def recorded(
    model: mujoco.MjModel, effects: Sequence[Effect], states: Array3, period: float
) -> Array3:
    """Readings of whole true episodes (episodes, rows, 2 nv), exact in their period."""
    readings = states.copy()
    for effect, sensing in _in_sensors(effects):
        if sensing.record is None:
            raise InvalidInput(
                f"{effect.kind} is not in what a sensor shows on average; round the readings, or "
                "add noise"
            )
        values = np.array(effect.values)
        for column in sensing.columns(model, element_of(model, effect.location)):
            readings[:, :, column] = sensing.record(readings[:, :, column], values, period)
    return readings


def _in_sensors(effects: Sequence[Effect]) -> list[tuple[Effect, Sensing]]:
    each = ((effect, get_mechanism(effect.kind).sensing) for effect in effects)
    return [(effect, sensing) for effect, sensing in each if sensing is not None]

"""The rules that every task must keep, checked by running it; also for users' own tasks.

    check_task(catalogue()["hopper"])       # InvalidInput names the task and what is wrong

`adr doctor` checks all installed tasks.
"""

import mujoco
import numpy as np

from adr_service.arrays import Vector
from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations
from adr_service.tasks.base import Entry, Source, State, Task, Variant

_N, _STEPS = 3, 5


def check_task(entry: Entry) -> None:
    """Raise InvalidInput if the task's functions, columns, models and variants do not fit together.

    The message names the task, the rule, the actual value and the expected one.
    """
    task = entry.task
    try:
        if not entry.variants:
            raise InvalidInput("it has no variant; at least one is needed")
        if not 0 < task.reward_threshold < np.inf:
            raise InvalidInput(
                "returns are divided by reward_threshold, which must be positive and finite; given "
                f"{task.reward_threshold}"
            )
        _check_numbers(task)
        _check_vanilla(entry)
        for name, variant in entry.variants.items():
            _check_hidden(name, variant)
            _check_source(task, variant.source, variant.truth)
            _check_source(task, variant.hidden.source, variant.hidden.values)
    except InvalidInput as error:
        raise InvalidInput(f"task {task.name!r}: {error}") from error
    except Exception as error:  # a user's own functions may raise anything
        raise InvalidInput(f"task {task.name!r}: {type(error).__name__}: {error}") from error


def _check_numbers(task: Task) -> None:
    low, high = np.asarray(task.action_low), np.asarray(task.action_high)
    if low.shape != high.shape:
        raise InvalidInput(f"action_low has shape {low.shape}, and action_high {high.shape}")
    if not (low < high).all():
        raise InvalidInput(f"action_low must be below action_high; given {low} and {high}")
    for name in ("horizon", "frame_skip"):
        number = getattr(task, name)
        if not (isinstance(number, int | np.integer) and number >= 1):
            raise InvalidInput(f"{name} must be a whole number of 1 or more; given {number!r}")
    if not 0 < task.learning_rate < np.inf:
        raise InvalidInput(
            f"learning_rate must be positive and finite; given {task.learning_rate!r}"
        )


def _check_vanilla(entry: Entry) -> None:
    """Raise InvalidInput unless the oracle can be trained: on the vanilla source, which can be the
    truth of every variant."""
    if "vanilla" not in entry.variants:
        raise InvalidInput(
            "it has no variant 'vanilla', on whose source the oracle is trained; it has "
            f"{', '.join(entry.variants)}"
        )
    source = entry.variants["vanilla"].source
    for name, variant in entry.variants.items():
        if variant.hidden.source.space != source.space:
            raise InvalidInput(
                f"the truth of the variant {name!r} is not over the parameters of the source of "
                f"'vanilla', which are {', '.join(source.space.names)}"
            )
        if variant.hidden.source != source:
            raise InvalidInput(
                f"the target of the variant {name!r} has the fixed values "
                f"{dict(variant.hidden.source.fixed)} and {len(variant.hidden.source.effects)} "
                f"effects, and the source of 'vanilla', on which the oracle is trained, "
                f"{dict(source.fixed)} and {len(source.effects)}; they must be the same"
            )


def _check_hidden(name: str, variant: Variant) -> None:
    """Raise InvalidInput if the noise or the truth of a variant cannot be simulated."""
    hidden = variant.hidden
    if not 0 <= hidden.noise_variance < np.inf:
        raise InvalidInput(
            f"noise_variance of the variant {name!r} must be 0 or more, and finite; given "
            f"{hidden.noise_variance!r}"
        )
    # simulations refuse another number of values
    for parameter, value in zip(hidden.source.space.parameters, hidden.values, strict=False):
        if value < parameter.feasible_low:
            raise InvalidInput(
                f"the truth of {parameter.name} in the variant {name!r} is {value:g}, below its "
                f"feasible_low of {parameter.feasible_low:g}"
            )


def _check_source(task: Task, source: Source, values: Vector) -> None:
    """Take a few steps under `values` and check every function of the task on the way."""
    simulations = Simulations(task, source, _N)
    simulations.set_dynamics(np.tile(values, (_N, 1)))
    initial, model = task.initial(_N, np.random.default_rng(0)), simulations.model(0)
    _check_bounds(task, model)
    _check_shape("initial's qpos", initial.qpos, (_N, model.nq))
    _check_shape("initial's qvel", initial.qvel, (_N, model.nv))
    simulations.set_state(initial)
    before = simulations.state
    for step in range(_STEPS):
        action = task.action_low if step % 2 else task.action_high
        simulations.step(action)
        after = simulations.state
        actions = np.tile(action, (_N, 1))
        _check_shape("observe", task.observe(after), (_N, len(task.columns)))
        reward, ended = task.reward(before, actions, after), task.terminated(after)
        _check_shape("reward", reward, (_N,))
        _check_shape("terminated", ended, (_N,))
        if not np.isfinite(reward).all():
            raise InvalidInput(f"reward must be finite; it gave {reward}")
        if ended.dtype != bool:
            raise InvalidInput(f"terminated must give booleans; it gave {ended.dtype}")
        before = after
    _check_round_trip(task, simulations)


def _check_bounds(task: Task, model: mujoco.MjModel) -> None:
    """Raise InvalidInput if the model would clip actions within their bounds."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL:
        return
    for i, (low, high) in enumerate(zip(task.action_low, task.action_high, strict=True)):
        least, most = model.actuator_ctrlrange[i]
        rounding = 1e-6 * (most - least)  # of bounds in float32
        is_within = least - rounding <= low and high <= most + rounding
        if model.actuator_ctrllimited[i] and not is_within:
            raise InvalidInput(
                f"action {i} has the bounds {low:g} to {high:g}, beyond the ctrlrange of its "
                f"actuator, {least:g} to {most:g}, to which the model clips it"
            )


def _check_round_trip(task: Task, simulations: Simulations) -> None:
    measured = task.observe(simulations.state)[:, : task.measured]
    state = task.state(measured)
    simulations.set_state(State(state.qpos, state.qvel))
    again = task.observe(simulations.state)[:, : task.measured]
    if not np.allclose(again, measured, atol=1e-9):
        raise InvalidInput(
            "observe(state(o)) must give the measured columns of o again; they differ by up to "
            f"{np.abs(again - measured).max():.3g}"
        )


def _check_shape(function: str, values: np.ndarray, expected: tuple[int, ...]) -> None:
    if values.shape != expected:
        raise InvalidInput(
            f"{function} gave shape {values.shape} for {_N} states; expected is {expected}"
        )

"""The rules that every task must keep, checked by running it; also for users' own tasks.

    check_task(catalogue()["hopper"])       # InvalidInput names the task and what is wrong

`adr doctor` checks all installed tasks. laws.py has the laws of their functions.
"""

from collections import Counter
from collections.abc import Sequence

import mujoco
import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.errors import InvalidInput
from adr_service.json_values import is_a_line
from adr_service.simulation.batch import Simulations
from adr_service.simulation.model import check_written_once, compiled
from adr_service.tasks.base import Entry, Source, State, Task, Variant
from adr_service.tasks.laws import initial_of, values_of

_FORBIDDEN = ("/", "\\", "?", "#", "%")  # in variants' names: URLs and paths give them a meaning
_N = 10  # starts
_STEPS, _RANDOM_STEPS = 5, 20  # with actions at their bounds, and between them


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
        _check_names(entry)
        _check_numbers(task)
        _check_vanilla(entry)
        checked: list[tuple[Source, list[float]]] = []  # variants share simulators
        for name, variant in entry.variants.items():
            _check_hidden(name, variant)
            hidden = variant.hidden
            for source, values in ((variant.source, variant.truth), (hidden.source, hidden.values)):
                if (source, values.tolist()) not in checked:
                    _check_source(task, source, values)
                    checked.append((source, values.tolist()))
    except InvalidInput as error:
        raise InvalidInput(f"task {task.name!r}: {error}") from error
    except Exception as error:  # a user's own functions may raise anything
        raise InvalidInput(f"task {task.name!r}: {type(error).__name__}: {error}") from error


def _check_names(entry: Entry) -> None:
    parameters = {name: None for v in entry.variants.values() for name in v.source.space.names}
    named = {"task": [entry.task.name], "variant": entry.variants, "parameter": parameters}
    for kind, names in {**named, "column": entry.task.columns}.items():
        for name in names:
            if not name.strip() or not is_a_line(name):
                raise InvalidInput(
                    f"the name of a {kind} must be a line of text; given {name!r}, which is empty "
                    "or has control characters"
                )
    for name in entry.variants:
        if "@" in name:
            raise InvalidInput(
                f"the variant {name!r} has an @ in its name, after which a domain lists effects"
            )
        if found := set(_FORBIDDEN) & set(name):
            raise InvalidInput(
                f"the variant {name!r} has {' '.join(sorted(found))} in its name; figures and "
                f"addresses are named after it, so it may have none of {' '.join(_FORBIDDEN)}"
            )
    if twice := [name for name, count in Counter(entry.task.columns).items() if count > 1]:
        raise InvalidInput(f"columns must have names of their own; twice: {', '.join(twice)}")


def _check_numbers(task: Task) -> None:
    low, high = np.asarray(task.action_low), np.asarray(task.action_high)
    if low.shape != high.shape:
        raise InvalidInput(f"action_low has shape {low.shape}, and action_high {high.shape}")
    if not ((low < high).all() and np.isfinite([low, high]).all()):
        raise InvalidInput(
            f"action_low must be below action_high, and both finite; given {low} and {high}"
        )
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
    """Raise InvalidInput if nothing is unknown in a variant, or its noise or truth cannot be
    simulated."""
    hidden = variant.hidden
    if not variant.source.space.parameters:
        raise InvalidInput(
            f"the source of the variant {name!r} has no parameter; at least one must be unknown"
        )
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
    """Check the task's functions and models with the truth `values` of a source's parameters."""
    check_written_once(compiled(task.xml), source)
    simulations = Simulations(task, source, _N)
    simulations.set_dynamics(np.tile(values, (_N, 1)))
    model = simulations.model(0)
    _check_bounds(task, model)
    initial = initial_of(task, _N, (model.nq, model.nv))
    simulations.set_state(initial)
    if values_of(task, "terminated", simulations.state).any():
        raise InvalidInput("terminated must be false in states that initial gives; it is true")
    rng, shape = np.random.default_rng(0), (_RANDOM_STEPS, _N, len(task.action_low))
    _check_steps(task, simulations, _at_bounds(task))
    _refuse_divergence(simulations, "the truth")
    _check_round_trip(task, simulations)
    _check_steps(task, simulations, [*rng.uniform(task.action_low, task.action_high, shape)])
    _check_smallest(task, source, simulations, initial)
    _check_parameters(task, source, values)


def _at_bounds(task: Task) -> list[Matrix]:
    bounds = (task.action_low if step % 2 else task.action_high for step in range(_STEPS))
    return [np.tile(bound, (_N, 1)) for bound in bounds]


def _check_steps(task: Task, simulations: Simulations, actions: Sequence[Matrix]) -> None:
    """Check the task's functions after each of the `actions` (n, a), while episodes last."""
    before = simulations.state
    lasts = np.ones(simulations.n, dtype=np.bool_)  # true where no episode has ended before
    for action in actions:
        simulations.step(action)
        after = simulations.state
        values_of(task, "observe", after, width=(len(task.columns),))
        reward = values_of(task, "reward", before, action, after)
        ended = values_of(task, "terminated", after)
        lasts &= ~simulations.diverged
        if not np.isfinite(reward[lasts]).all():
            raise InvalidInput(f"reward must be finite; it gave {reward[lasts]}")
        if ended.dtype != bool:
            raise InvalidInput(f"terminated must give booleans; it gave {ended.dtype}")
        lasts &= ~ended
        before = after


def _check_smallest(task: Task, source: Source, simulations: Simulations, initial: State) -> None:
    """Raise InvalidInput if the smallest feasible values cannot be simulated."""
    where = "the feasible_low of all parameters"
    try:
        simulations.set_dynamics(np.tile(source.space.feasible_low, (_N, 1)))
    except RuntimeError as error:  # of MuJoCo
        raise InvalidInput(f"MuJoCo refuses {where}: {error}") from error
    model = simulations.model(0)
    for body in np.flatnonzero(model.body_mass < 0):
        name, mass = model.body(body).name, model.body_mass[body]
        raise InvalidInput(f"at {where}, the body {name!r} has the negative mass {mass:g} kg")
    simulations.set_state(initial)
    for action in _at_bounds(task):
        simulations.step(action)
    _refuse_divergence(simulations, where)


def _refuse_divergence(simulations: Simulations, where: str) -> None:
    if simulations.diverged.any():
        raise InvalidInput(f"the simulation diverges within {_STEPS} steps at {where}")


def _check_parameters(task: Task, source: Source, values: Vector) -> None:
    """Raise InvalidInput if a parameter changes no prediction in an episode of random actions.

    One simulation is at the truth, and one per parameter at its bound that is farther from it.
    """
    space, n = source.space, len(source.space) + 1
    farther = np.where(values - space.low > space.high - values, space.low, space.high)
    draws = np.tile(values, (n, 1))
    draws[np.arange(1, n), np.arange(n - 1)] = farther
    rng = np.random.default_rng(0)
    start = task.initial(1, rng)
    simulations = Simulations(task, source, n)
    simulations.set_dynamics(draws)
    simulations.set_state(State(start.qpos.repeat(n, axis=0), start.qvel.repeat(n, axis=0)))
    is_seen = np.zeros(n - 1, dtype=np.bool_)
    for _ in range(task.horizon):
        simulations.step(rng.uniform(task.action_low, task.action_high))
        observed = task.observe(simulations.state)[:, : task.measured]
        is_seen |= (observed[1:] != observed[0]).any(axis=1)
        if is_seen.all():  # nearly always within a few steps
            return
    i = int(np.argmin(is_seen))
    parameter = space.parameters[i]
    raise InvalidInput(
        f"the parameter {parameter.name!r} ({parameter.address}) changes no measured column in an "
        f"episode of random actions, whether it is {values[i]:g} or {farther[i]:g}; no data could "
        "show its value"
    )


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

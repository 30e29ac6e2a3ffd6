"""What every task must keep, checked by running it: `adr doctor` does, for installed ones too."""

import numpy as np

from adr_service.errors import InvalidInput
from adr_service.simulation.batch import Simulations
from adr_service.tasks.base import Entry, State, Task

_N, _STEPS = 3, 5


def check(entry: Entry) -> None:
    """Refuse a task whose functions do not fit each other, its columns or its models.

    Raises InvalidInput that names the task, and what was found and expected.
    """
    task = entry.task
    if not entry.variants:
        raise InvalidInput(f"{task.name} has no variant")
    try:
        for variant in entry.variants.values():
            for source, values in (
                (variant.source, variant.truth),
                (variant.hidden.source, variant.hidden.values),
            ):
                simulations = Simulations(task, source, _N)
                simulations.set_dynamics(np.tile(values, (_N, 1)))
                _walk(task, simulations)
    except InvalidInput as error:
        raise InvalidInput(f"task {task.name!r}: {error}") from error


def _walk(task: Task, simulations: Simulations) -> None:
    """A few steps, with every function of the task at each."""
    simulations.set_state(task.initial(_N, np.random.default_rng(0)))
    before = simulations.state
    for step in range(_STEPS):
        action = task.action_low if step % 2 else task.action_high
        simulations.step(action)
        after = simulations.state
        actions = np.tile(action, (_N, 1))
        _shaped("observe", task.observe(after), (_N, len(task.columns)))
        _shaped("reward", task.reward(before, actions, after), (_N,))
        _shaped("terminated", task.terminated(after), (_N,))
        before = after
    measured = task.observe(before)[:, : task.measured]
    state = task.state(measured)
    simulations.set_state(State(state.qpos, state.qvel))
    again = task.observe(simulations.state)[:, : task.measured]
    if not np.allclose(again, measured, atol=1e-9):
        raise InvalidInput(
            "observe(state(o)) must give the measured columns of o again; they differ by up to "
            f"{np.abs(again - measured).max():.3g}"
        )


def _shaped(function: str, found: np.ndarray, expected: tuple[int, ...]) -> None:
    if found.shape != expected:
        raise InvalidInput(f"{function} gave shape {found.shape}; of {_N} states it is {expected}")

"""The laws of a task's functions: shapes, seeds, row by row, and arguments left as they are."""

from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adr_service.arrays import Matrix
from adr_service.errors import InvalidInput
from adr_service.tasks.base import State, Task

_ROUNDING = 1e-6  # of functions that compute in float32


def values_of(
    task: Task, function: str, *arguments: State | Matrix, width: tuple[int, ...] = ()
) -> NDArray[Any]:
    """The values (n, *width) of `observe`, `reward` or `terminated`.

    Raises InvalidInput unless the first and the last row alone give the same, and the function has
    written into none of its arguments.
    """
    call, kept = getattr(task, function), deepcopy(arguments)
    values = call(*arguments)
    n = len(_arrays(arguments)[0])
    check_shape(function, values, (n, *width))
    pairs = zip(_arrays(arguments), _arrays(kept), strict=True)
    if not all(np.array_equal(*pair, equal_nan=True) for pair in pairs):
        raise InvalidInput(f"{function} must not write into its arguments; it changed them")
    for row in (0, n - 1):
        alone = call(*(_row(argument, row) for argument in kept))[0]
        if not np.allclose(alone, values[row], _ROUNDING, _ROUNDING, equal_nan=True):
            raise InvalidInput(
                f"{function} must treat every simulation by itself; row {row} of {n} gave "
                f"{values[row]}, and the same state alone {alone}"
            )
    return values


def initial_of(task: Task, n: int, shapes: tuple[int, int]) -> State:
    """n initial states with `shapes` = (nq, nv) numbers each.

    Raises InvalidInput unless the generator alone decides them; they may all be the same.
    """
    first, again, other = (task.initial(n, np.random.default_rng(seed)) for seed in (0, 0, 1))
    check_shape("initial's qpos", first.qpos, (n, shapes[0]))
    check_shape("initial's qvel", first.qvel, (n, shapes[1]))
    rows, same, others = (np.hstack([s.qpos, s.qvel]) for s in (first, again, other))
    if not np.array_equal(rows, same):
        raise InvalidInput(
            "initial must draw from the generator that it is given, and from nothing else; the "
            "same seed gave other states"
        )
    if np.array_equal(rows, others) and (rows != rows[0]).any():
        raise InvalidInput(
            "initial must draw from the generator that it is given; its states vary, but not with "
            "the seed"
        )
    return first


def check_shape(function: str, values: NDArray[Any], expected: tuple[int, ...]) -> None:
    if values.shape != expected:
        raise InvalidInput(
            f"{function} gave shape {values.shape} for {expected[0]} states; expected is {expected}"
        )


def _arrays(arguments: tuple[State | Matrix, ...]) -> list[NDArray[Any]]:
    return [
        array
        for argument in arguments
        for array in (argument if isinstance(argument, State) else (argument,))
    ]


def _row(argument: State | Matrix, row: int) -> State | Matrix:
    if isinstance(argument, State):
        return State(*(values[row : row + 1] for values in argument))
    return argument[row : row + 1]

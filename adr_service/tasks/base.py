"""What a task is: a robot, a goal, and the variants in which its simulator is uncertain.

A variant pairs a *source* (what methods may simulate: a parameter space and values that stay
fixed) with a *target* (the hidden truth and its sensor noise). Methods get a task and a source;
the truth is in the catalogue, which they may not import (a contract of `make lint`), and is read
by `adr_service.target` alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector
from adr_service.parameters import ParameterSpace


class State(NamedTuple):
    """The simulator state of n simulations."""

    qpos: Matrix  # (n, nq)
    qvel: Matrix  # (n, nv)


@dataclass(frozen=True)
class Source:
    """A simulator with unknowns: `space` may vary, `fixed` (address -> value) may not."""

    space: ParameterSpace
    fixed: Mapping[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True)
class Hidden:
    """The truth behind a simulated target. Nothing outside `target.py` may read it."""

    source: Source  # the space in which `values` are given
    values: Vector  # (d,) SI units
    noise_variance: float  # added to every observed column, in its unit squared


@dataclass(frozen=True)
class Variant:
    source: Source
    hidden: Hidden


class Task(Protocol):
    """A robot and a goal. All functions are vectorised over n simulations."""

    @property
    def name(self) -> str: ...
    @property
    def xml(self) -> str: ...  # MJCF, one file in `assets/`
    @property
    def frame_skip(self) -> int: ...  # simulator steps per control step
    @property
    def columns(self) -> tuple[str, ...]: ...  # observation columns with units
    @property
    def action_low(self) -> Vector: ...  # (a,)
    @property
    def action_high(self) -> Vector: ...  # (a,)
    @property
    def horizon(self) -> int: ...  # control steps per episode
    @property
    def reward_threshold(self) -> float: ...  # training stops here; returns are divided by it
    @property
    def learning_rate(self) -> float: ...

    def initial(self, n: int, rng: np.random.Generator) -> State:
        """n fresh initial states."""
        ...

    def observe(self, state: State) -> Matrix:
        """What policies see of `state`, without sensor noise: (n, s)."""
        ...

    def state(self, observations: Matrix) -> State:
        """A state that `observe` maps to `observations`."""
        ...

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        """Reward of a control step, (n,)."""
        ...

    def terminated(self, state: State) -> Mask:
        """Whether the episode ends in `state`, (n,)."""
        ...

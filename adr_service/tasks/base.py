"""Tasks: a robot, a goal, and the variants in which its simulator is uncertain.

A variant pairs a *source* (the simulator that methods may use: a parameter space and fixed
values) with a *target* (the hidden truth and its sensor noise). Methods get a task and a source.
The truth is in the catalogue, which they may not import (a contract of `make lint`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np

from adr_service.arrays import Mask, Matrix, Vector, frozen
from adr_service.effects.base import Effect
from adr_service.parameters import ParameterSpace

if TYPE_CHECKING:  # MuJoCo takes a tenth of a second to import
    import mujoco

_WRONG = 0.8  # random-envs: unmodeled sources have wrong parameters at this share of the truth


class State(NamedTuple):
    """The simulator state of n simulations."""

    qpos: Matrix  # (n, nq)
    qvel: Matrix  # (n, nv)
    derived: Matrix = frozen(np.empty((0, 0)))  # (n, k) fields of the task's `derived`


@dataclass(frozen=True)
class Source:
    """A simulator with unknowns: `space` may vary, `fixed` (address -> value) may not."""

    space: ParameterSpace
    fixed: Mapping[str, float] = field(default_factory=dict[str, float])
    effects: tuple[Effect, ...] = ()  # beyond what the task's file has


@dataclass(frozen=True)
class Hidden:
    """The truth behind a simulated target, which no method may read."""

    source: Source  # with the space of `values`
    values: Vector  # (d,) SI units
    noise_variance: float  # of the noise on every measured column, in its unit squared


@dataclass(frozen=True)
class Variant:
    source: Source
    hidden: Hidden

    @property
    def truth(self) -> Vector:
        """The hidden values of the source's own parameters, (d,)."""
        space = self.hidden.source.space
        return self.hidden.values[[space.index(name) for name in self.source.space.names]]


@dataclass(frozen=True)
class Entry:
    """A task with its variants by name, as the catalogue lists it."""

    task: "Task"
    variants: Mapping[str, Variant]


def freeze(space: ParameterSpace, truth: Sequence[float], names: Sequence[str]) -> Source:
    """A source in which `names` are wrong: not in its space, and fixed at 0.8 of their truth."""
    known = dict(zip(space.names, truth, strict=True))
    rest = space.subset(tuple(name for name in space.names if name not in names))
    wrong = {space.parameters[space.index(n)].address: _WRONG * known[n] for n in names}
    return Source(rest, wrong)


def benchmark_variants(
    space: ParameterSpace, truth: Sequence[float], noise_variance: float, unmodeled: Source
) -> Mapping[str, Variant]:
    """The benchmark's three variants (Tiboni et al., Sec. 3.3) and two of ours, with one truth.

    In ours, the search for the parameters that `unmodeled` freezes ends at the truth (`edge`) or at
    0.8 of it (`outside`), to show how methods estimate at a bound: the paper's bounds hold the
    truth well inside. Ours are left out if `unmodeled` freezes nothing, or if the bounds of a
    frozen parameter do not hold both the truth and 0.8 of it.
    """
    source, values = Source(space), frozen(truth)
    hidden = Hidden(source, values, 0.0)
    variants = {
        "vanilla": Variant(source, hidden),
        "noisy": Variant(source, Hidden(source, values, noise_variance)),
        "unmodeled": Variant(unmodeled, hidden),
    }
    missing = [n for n, name in enumerate(space.names) if name not in unmodeled.space.names]
    is_within = (space.low[n] < _WRONG * truth[n] < truth[n] <= space.high[n] for n in missing)
    if missing and all(is_within):
        for name, share in (("edge", 1.0), ("outside", _WRONG)):
            variants[name] = Variant(Source(_ending(space, truth, missing, share)), hidden)
    return variants


def _ending(
    space: ParameterSpace, truth: Sequence[float], which: Sequence[int], share: float
) -> ParameterSpace:
    """A space whose search bounds of some parameters end at a share of their truth."""
    parameters = list(space.parameters)
    for number in which:
        parameters[number] = replace(parameters[number], high=share * truth[number])
    return ParameterSpace(tuple(parameters))


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
    def measured(
        self,
    ) -> int: ...  # leading columns, which sensors measure and inference uses
    @property
    def derived(self) -> tuple[str, ...]: ...  # MjData fields that `observe` or `reward` need
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
        """n random initial states."""
        ...

    def observe(self, state: State) -> Matrix:
        """The policy's view of `state`, without sensor noise: (n, s)."""
        ...

    def state(self, observations: Matrix) -> State:
        """A state with the measured columns of `observations` (n, at least `measured`)."""
        ...

    def reward(self, before: State, action: Matrix, after: State) -> Vector:
        """Reward of a control step, (n,)."""
        ...

    def terminated(self, state: State) -> Mask:
        """True where the episode ends in `state`, (n,); diverged episodes end in any case."""
        ...


@runtime_checkable
class Reshapable(Protocol):
    """A task whose parameters include link lengths, at addresses `link:name.length`."""

    def reshape(self, spec: "mujoco.MjSpec", lengths: Mapping[str, float]) -> None:
        """Set link lengths [m] in the model of `xml`, fresh or reshaped before."""
        ...

"""Interfaces of ADR methods: evidence about the target in, a distribution to train on out.

Methods never train a policy and never touch the target. An `OfflineMethod` turns recorded
transitions into an estimate. An `OnlineMethod` is asked for a distribution, and learns from the
target's trajectory of the policy that was trained on it. State is a JSON value, so that a run can
stop and go on.

A method's settings are its entry in the catalogue. They say all that differs between methods: how
to make the method, which program runs it, what it learns from, what it costs, and how reports show
it (docs/add-a-method.md).
"""

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Protocol, Self, cast

import numpy as np

from adr_service.distributions import Distribution
from adr_service.json_values import Wire
from adr_service.progress import Progress
from adr_service.tasks.base import Source, Task
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset


@dataclass(frozen=True)
class Problem:
    """What a method may simulate: the task, and its source with the unknowns."""

    task: Task
    source: Source


@dataclass(frozen=True)
class Evidence:
    """What the target showed of one policy."""

    policy: Policy
    data: TransitionDataset


@dataclass(frozen=True)
class Estimate:
    """An inferred distribution, what it cost, and what a reader should know of it."""

    distribution: Distribution
    simulated_steps: int  # control steps
    diagnostics: dict[str, Any] = field(default_factory=dict[str, Any])  # JSON


@dataclass(frozen=True)
class Update:
    """A new state of an online method, what it cost, and what a reader should know of it."""

    state: dict[str, Any]  # JSON
    simulated_steps: int  # control steps
    diagnostics: dict[str, Any] = field(default_factory=dict[str, Any])  # JSON


class OfflineMethod(Protocol):
    def fit(
        self,
        problem: Problem,
        data: TransitionDataset,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Estimate: ...


class OnlineMethod(Protocol):
    def start(self, problem: Problem) -> dict[str, Any]:
        """The state before any evidence."""
        ...

    def ask(self, problem: Problem, state: dict[str, Any]) -> Distribution:
        """The distribution to train the next policy on."""
        ...

    def tell(
        self,
        problem: Problem,
        state: dict[str, Any],
        evidence: Evidence,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Update:
        """The state after `evidence` of a policy trained on what `ask` gave."""
        ...


Data = Literal["nothing", "returns", "visits", "recordings"]


class MethodSettings(Wire):
    """Settings of a method."""

    name: Any  # the method's: a `Literal` in each class, which `str` could not become

    program: ClassVar[str]  # module with the function `run` for runs of the method
    learns_from: ClassVar[Data]  # the target's returns, its own visits, or others' recordings
    grid: ClassVar["Grid | None"] = None
    believes: ClassVar[bool] = False  # each answer is one distribution, an estimate
    needs_truth: ClassVar[bool] = False  # trains on the hidden truth, in the target's own space
    is_reference: ClassVar[bool] = False  # part of every benchmark, to compare with
    is_level: ClassVar[bool] = False  # evaluated once, without iterations
    collects: ClassVar[bool] = False  # its visits are the data of offline methods by default
    label: ClassVar[str] = ""  # in figures; empty: the name
    # in figures; one per method everywhere, Okabe and Ito's, which colour-blind readers tell apart
    colour: ClassVar[str] = "#882255"

    @property
    def infers(self) -> bool:
        """True if the method infers distributions from transitions of the target."""
        return self.learns_from in ("visits", "recordings")

    @property
    def each(self) -> "list[Self]":
        """These settings with one value each in the place of the grid's list."""
        if self.grid is None:
            return [self]
        given: Any = getattr(self, self.grid.field)
        values = cast(list[Any], given) if isinstance(given, list) else [given]
        return [self.model_copy(update={self.grid.field: value}) for value in values]


@dataclass(frozen=True)
class Grid:
    """A setting that may have several values, tried side by side; the best answer counts."""

    field: str  # of the settings
    criterion: str  # diagnostic of an estimate; the smallest is the best


class OfflineSettings(MethodSettings):
    """Settings of a method that learns from recorded transitions."""

    program: ClassVar[str] = "adr_service.programs.offline"
    learns_from: ClassVar[Data] = "recordings"
    believes: ClassVar[bool] = True

    @abstractmethod
    def create(self) -> OfflineMethod: ...

    @abstractmethod
    def planned_steps(self, parameters: int, transitions: int) -> int:
        """Control steps that one inference from so many transitions simulates, about."""
        ...


class OnlineSettings(MethodSettings):
    """Settings of a method that learns from visits of the policy of its last distribution."""

    program: ClassVar[str] = "adr_service.programs.online"
    learns_from: ClassVar[Data] = "visits"
    believes: ClassVar[bool] = True

    @abstractmethod
    def create(self) -> OnlineMethod: ...

    @abstractmethod
    def planned_steps(self, parameters: int, transitions: int) -> int:
        """Control steps that one inference from so many transitions simulates, at most."""
        ...

"""Interfaces of ADR methods, which turn evidence about the target into a distribution to train on.

A method never trains a policy and never touches the target. An `OfflineMethod` fits an estimate
to recorded transitions. An `OnlineMethod` proposes a distribution (`ask`) and learns from the
trajectories of a policy that was trained on it (`tell`). The caller keeps its state, a JSON value,
so that a run can stop and go on. A `ReturnsMethod` sees what policies earned, and no transitions.
Some methods have no target data at all: their answer is a `Curriculum`, a distribution that moves
while the policy is trained on it.

The settings of a method are its entry in the catalogue. They hold all that differs between
methods: the program that runs the method, the data it learns from, the cost of an inference, and
its name and colour in figures (docs/add-a-method.md).
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Protocol, Self, cast

import numpy as np
from pydantic import Field

from adr_service.arrays import Vector
from adr_service.citations import Paper
from adr_service.distributions import Distribution
from adr_service.errors import InvalidInput
from adr_service.json_values import Wire
from adr_service.progress import Progress
from adr_service.tasks.base import Source, Task
from adr_service.training.curriculum import Curriculum
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset


@dataclass(frozen=True)
class Problem:
    """The simulator that a method may use: a task, and a source with unknown parameters."""

    task: Task
    source: Source


@dataclass(frozen=True)
class Evidence:
    """Transitions that one policy recorded on the target."""

    policy: Policy
    data: TransitionDataset
    # of the run's policies before, for methods that remember; they have no earlier ones themselves
    earlier: "tuple[Evidence, ...]" = ()


@dataclass(frozen=True)
class Estimate:
    """An inferred distribution, the cost of inferring it, and diagnostics for a reader.

    `simulated_steps` are those of the search. DROPO and sysid also replay their answer once, for
    `mean_squared_error`, which adds .06 % to .5 % and is not counted.
    """

    distribution: Distribution
    simulated_steps: int  # control steps
    diagnostics: dict[str, Any] = field(default_factory=dict[str, Any])  # JSON


@dataclass(frozen=True)
class Update:
    """A new state of an online method, the cost of computing it, and diagnostics for a reader."""

    state: dict[str, Any]  # JSON
    simulated_steps: int  # control steps
    diagnostics: dict[str, Any] = field(default_factory=dict[str, Any])  # JSON


@dataclass(frozen=True)
class Proposal:
    """The next distribution to try, the best one so far, and diagnostics for a reader."""

    next: Distribution  # to train on next
    best: int  # index of the distribution whose policy is believed best
    simulated_steps: int = 0  # control steps
    diagnostics: dict[str, Any] = field(default_factory=dict[str, Any])  # JSON


class OfflineMethod(Protocol):
    """A method that learns once, from recorded transitions."""

    def fit(
        self,
        problem: Problem,
        data: TransitionDataset,
        rng: np.random.Generator,
        progress: Progress,
    ) -> Estimate:
        """Fit a distribution to recorded transitions; all random numbers come from `rng`."""
        ...


class OnlineMethod(Protocol):
    """A method that learns from the policies trained on its own distributions."""

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
        """The state after `evidence` of a policy trained on the distribution of `ask`."""
        ...


class ReturnsMethod(Protocol):
    """A method that learns from what policies earn on the target, and sees no transitions."""

    def propose(
        self,
        problem: Problem,
        distributions: Sequence[Distribution],
        returns: Vector,
        rng: np.random.Generator,
    ) -> Proposal:
        """The proposal after policies trained on `distributions` earned `returns` (n,)."""
        ...


Data = Literal["nothing", "returns", "visits", "recordings"]
ReplayFrom = Literal["recorded", "smoothed"]


class MethodSettings(Wire):
    """Settings of a method."""

    name: Any  # of the method: a `Literal` in each class, which could not narrow a `str`

    program: ClassVar[str]  # module with the function `run` for runs of the method
    # returns, visits by its own policies, recordings of others, or nothing (without iterations)
    learns_from: ClassVar[Data]
    grid: ClassVar["Grid | None"] = None  # setting that is tried with several values
    believes: ClassVar[bool] = False  # each answer is one distribution, an estimate
    needs_truth: ClassVar[bool] = False  # trains on the hidden truth, in the target's own space
    is_reference: ClassVar[bool] = False  # part of every benchmark, to compare with
    # states in the data from which replays start: as they were recorded, as in the papers of all
    # offline methods, or without their sensors' noise (criticism.smoothing)
    replay_from: ClassVar[ReplayFrom] = "recorded"
    extra: ClassVar[str] = ""  # of our package, and the module in it, that the method needs
    # of an answer beside what it simulates, about, on one core
    seconds: ClassVar[float] = 0.0
    remembers: ClassVar[bool] = False  # an online method learns from all visits, not the last alone
    # its visits are the data of offline methods by default; SimOpt's, which `RunSpec.simopt` holds
    collects: ClassVar[bool] = False
    label: ClassVar[str] = ""  # in figures; empty: the name
    papers: ClassVar[tuple[Paper, ...]] = ()  # to cite for it
    # in figures; ours are Okabe and Ito's colours, which colour-blind readers can distinguish
    colour: ClassVar[str] = "#882255"

    @property
    def infers(self) -> bool:
        """True if the method infers distributions from transitions of the target."""
        return self.learns_from in ("visits", "recordings")

    @property
    def least_transitions(self) -> int:
        """Number of consecutive transitions of an episode that the method needs at least."""
        return 1

    def check_parameters(self, count: int) -> None:
        """Raise ValueError if the method cannot infer so many parameters with these settings."""

    @property
    def each(self) -> "list[Self]":
        """These settings once per value of the grid's list, each with that one value."""
        if self.grid is None:
            return [self]
        setting: Any = getattr(self, self.grid.field)
        values = cast(list[Any], setting) if isinstance(setting, list) else [setting]
        return [self.model_copy(update={self.grid.field: value}) for value in values]


@dataclass(frozen=True)
class Grid:
    """A setting that may have several values, tried side by side; the best answer counts."""

    field: str  # of the settings
    criterion: str  # of the answers' diagnostics; smaller is better
    TIE: ClassVar[float] = 0.01  # relative difference of two criteria that decides nothing

    def best(self, criteria: Sequence[float | None]) -> int:
        """Index of the best answer: the first one within `TIE` of the smallest criterion.

        Raises InvalidInput if no criterion is a finite number.
        """
        known = {i: c for i, c in enumerate(criteria) if c is not None and np.isfinite(c)}
        if not known:
            raise InvalidInput(
                f"no {self.field} gives an answer that predicts: each {self.criterion} is one of "
                f"{list(criteria)}"
            )
        least = min(known.values())
        return next(i for i, c in known.items() if c <= least + self.TIE * abs(least))


class OfflineSettings(MethodSettings):
    """Settings of a method that learns from recorded transitions."""

    program: ClassVar[str] = "adr_service.programs.offline"
    learns_from: ClassVar[Data] = "recordings"
    believes: ClassVar[bool] = True

    @abstractmethod
    def create(self) -> OfflineMethod:
        """The method with these settings."""
        ...

    @abstractmethod
    def planned_steps(self, parameters: int, transitions: int) -> int:
        """Control steps that one inference simulates, about.

        The source has `parameters` unknowns; the data have `transitions`.
        """
        ...


class OnlineSettings(MethodSettings):
    """Settings of a method that learns from visits of the policy of its last distribution."""

    program: ClassVar[str] = "adr_service.programs.online"
    learns_from: ClassVar[Data] = "visits"
    believes: ClassVar[bool] = True

    @abstractmethod
    def create(self) -> OnlineMethod:
        """The method with these settings."""
        ...

    @abstractmethod
    def planned_steps(self, parameters: int, transitions: int) -> int:
        """Control steps that one inference simulates, at most.

        The source has `parameters` unknowns; the evidence has `transitions`.
        """
        ...


class ReturnsSettings(MethodSettings):
    """Settings of a method that learns from target returns.

    It starts from the returns of UDR's policies, and trains one more policy per iteration.
    """

    initial: int = Field(10, ge=2, le=1000, description="policies of UDR to start from")
    report: Literal["retrained", "best"] = Field(
        "retrained",
        description="retrained: a new policy on the box that is believed best; best: the policy "
        "whose return was measured there",
    )

    program: ClassVar[str] = "adr_service.programs.returns"
    learns_from: ClassVar[Data] = "returns"

    @abstractmethod
    def create(self) -> ReturnsMethod:
        """The method with these settings."""
        ...


class CurriculumSettings(MethodSettings):
    """Settings of a method without target data, which moves the distribution of one training."""

    program: ClassVar[str] = "adr_service.programs.curriculum"
    learns_from: ClassVar[Data] = "nothing"

    @abstractmethod
    def create(self, problem: Problem) -> Curriculum:
        """The curriculum of a training on the problem's source, at its start."""
        ...

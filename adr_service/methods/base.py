"""What an ADR method is: evidence about the target in, a distribution to train on out.

Methods never train a policy and never touch the target. An `OfflineMethod` turns recorded
transitions into an estimate; an `OnlineMethod` is asked for a distribution, and told what the
policy trained on it did on the target. State is a JSON value, so that a run can stop and go on.

A method's settings are its entry in the catalogue: they know how to make the method, and what it
will cost (docs/add-a-method.md).
"""

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, Protocol

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


class MethodSettings(Wire):
    """Settings of a method."""

    name: Any  # the method's: a `Literal` in each class, which `str` could not become


class OfflineSettings(MethodSettings):
    """Settings of a method that learns from recorded transitions."""

    @abstractmethod
    def create(self) -> OfflineMethod: ...

    @abstractmethod
    def planned_steps(self, parameters: int, transitions: int) -> int:
        """Control steps that one inference from so many transitions simulates, about."""
        ...


class OnlineSettings(MethodSettings):
    """Settings of a method that is told what the policy of its last distribution did."""

    @abstractmethod
    def create(self) -> OnlineMethod: ...

    @abstractmethod
    def planned_steps(self, parameters: int, transitions: int) -> int:
        """Control steps that one inference from so many transitions simulates, at most."""
        ...

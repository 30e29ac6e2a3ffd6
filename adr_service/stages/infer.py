"""Infer a distribution from what the target showed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np

from adr_service.distributions import Distribution, check_space
from adr_service.errors import InvalidInput
from adr_service.events import RunEvent
from adr_service.methods.base import (
    Evidence,
    MethodSettings,
    OfflineSettings,
    OnlineSettings,
    Problem,
)
from adr_service.methods.catalogue import check_installed
from adr_service.npz import names_in, read_arrays, write_arrays
from adr_service.parameters import ParameterSpace
from adr_service.progress import Progress
from adr_service.stages.base import Belief, CoreSpeed, Cost, Result, Role, Stage
from adr_service.stages.stand_ins import gaussian
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.training.policy import Policy
from adr_service.transitions import TransitionDataset


class Inferred(Result):
    """A method's answer, and an online method's new state."""

    distribution: Belief
    state: dict[str, Any] | None = None  # JSON; of online methods
    simulated_steps: int  # control steps
    diagnostics: dict[str, Any]  # JSON


@dataclass(frozen=True, kw_only=True)
class Infer(Stage[Inferred]):
    """One inference of a method.

    An offline method has no state, and learns from the data alone. An online method gets its state
    before, and the policy that made the data; one that remembers, also the visits `earlier`.
    """

    kind: ClassVar = "infer"
    # 3: DROPO's trust region, SimOpt's full covariance. Mends for constant columns and singular
    # covariances kept it (docs/decisions.md, "Mends that keep a version")
    version: ClassVar = 3
    role: ClassVar[Role] = "inference"
    result: ClassVar = Inferred

    variant: str  # a domain; the field's name is part of the digest
    seed: int
    method: MethodSettings
    method_package: str | None = None
    state: dict[str, Any] | None = None  # JSON
    policy: bytes | None = None
    data: bytes  # an .npz of transitions
    earlier: bytes | None = None  # visits before, `packed`

    @property
    def space(self) -> ParameterSpace:
        """The space of the distribution."""
        return source_of(self.task, self.variant).space

    def compute(self, rng: np.random.Generator, progress: Progress) -> Inferred:
        check_installed(self.method.name)
        problem = Problem(get_task(self.task), source_of(self.task, self.variant))
        data = TransitionDataset.from_npz(self.data)
        if self.method.learns_from == "recordings":
            offline = cast(OfflineSettings, self.method).create()
            estimate = offline.fit(problem, data, rng, progress)
            return Inferred(
                distribution=estimate.distribution,
                simulated_steps=estimate.simulated_steps,
                diagnostics=self._remarked(estimate.distribution, estimate.diagnostics),
            )
        assert self.policy is not None, "an online method learns from a visit of its policy"
        assert self.state is not None, "an online method has a state"
        online = cast(OnlineSettings, self.method).create()
        earlier = tuple(
            Evidence(Policy.from_bytes(policy), seen) for policy, seen in unpacked(self.earlier)
        )
        evidence = Evidence(Policy.from_bytes(self.policy), data, earlier)
        update = online.tell(problem, self.state, evidence, rng, progress)
        distribution = online.ask(problem, update.state)
        return Inferred(
            distribution=distribution,
            state=update.state,
            simulated_steps=update.simulated_steps,
            diagnostics=self._remarked(distribution, update.diagnostics),
        )

    def _remarked(self, distribution: Distribution, found: dict[str, Any]) -> dict[str, Any]:
        """A method's diagnostics, and the parameters whose mean is at a bound of the search.

        Raises InvalidInput where the distribution is over another space.
        """
        check_space(f"the distribution of {self.method.name}", distribution, self.space)
        return {**found, "at_bound": self.space.at_bound(distribution.mean)}

    def events(self, result: Inferred) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        transitions = len(TransitionDataset.from_npz(self.data))
        transitions += sum(len(data) for _, data in unpacked(self.earlier))
        steps = self._planned_steps(transitions)
        return Cost(steps / speed.steps_per_second(self.task) + self.method.seconds)

    def _planned_steps(self, transitions: int) -> float:
        """The control steps that the method plans, finite and not negative.

        A plug-in's function may give or raise anything.
        """
        settings = cast(OfflineSettings | OnlineSettings, self.method)
        name = f"planned_steps of {self.method.name}"
        try:
            steps: Any = settings.planned_steps(len(self.space), transitions)
        except Exception as error:  # of a plug-in
            raise InvalidInput(f"{name} raised {type(error).__name__}: {error}") from error
        if not (
            isinstance(steps, int | float | np.integer | np.floating) and 0 <= steps < math.inf
        ):
            raise InvalidInput(f"{name} must be a finite number of 0 or more; it gave {steps!r}")
        return float(steps)

    def stand_in(self) -> Inferred:
        grid = self.method.grid
        return Inferred(
            distribution=gaussian(self.space, self.digest),
            state=None if self.state is None else {"stand_in": self.digest},
            simulated_steps=0,
            diagnostics={} if grid is None else {grid.criterion: 0.0},
        )


def packed(visits: Sequence[tuple[bytes, TransitionDataset]]) -> bytes:
    """Policies and what each recorded, as one `.npz`."""
    arrays: dict[str, np.ndarray] = {}
    for number, (policy, data) in enumerate(visits):
        for name, content in (("policy", policy), ("data", data.to_npz())):
            arrays[f"{name}_{number}"] = np.frombuffer(content, dtype=np.uint8)
    return write_arrays(arrays)


def unpacked(content: bytes | None) -> list[tuple[bytes, TransitionDataset]]:
    """The visits in a file of `packed`; none without a file."""
    if content is None:
        return []
    # `packed` writes bytes and compresses nothing, so that a run may have any number of visits
    arrays = read_arrays(content, names_in(content), most=len(content))
    return [
        (arrays[f"policy_{i}"].tobytes(), TransitionDataset.from_npz(arrays[f"data_{i}"].tobytes()))
        for i in range(len(arrays) // 2)
    ]

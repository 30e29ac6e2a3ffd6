"""Online methods: repeat: train -> visit the target -> update the estimate."""

from collections.abc import Generator, Sequence
from typing import Any, cast

from adr_service.distributions import Distribution
from adr_service.events import RunEvent
from adr_service.methods.base import OnlineSettings
from adr_service.programs.steps import (
    Inference,
    evaluate_and_report,
    infer,
    joined,
    problem_of,
    training,
)
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.stages.infer import Inferred, packed
from adr_service.stages.train_policy import TrainedPolicy
from adr_service.target import Target, Visit, open_target
from adr_service.transitions import TransitionDataset


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    loop = OnlineLoop(spec, stages, open_target(spec, stages))
    for iteration in range(spec.iterations + 1):
        trained = yield from loop.train()
        yield from evaluate_and_report(
            loop.target, iteration, [loop.distribution], [trained], loop.inference
        )
        if iteration < spec.iterations:
            visit = yield from loop.visit(trained, iteration)
            yield from loop.update([visit])


class OnlineLoop:
    """One online method at work: its distribution to train on, and its last inference."""

    def __init__(self, spec: RunSpec, stages: Stages, target: Target):
        self._spec, self._stages, self.target = spec, stages, target
        method, problem = cast(OnlineSettings, spec.method).create(), problem_of(spec)
        self._state: dict[str, Any] = method.start(problem)
        self.distribution: Distribution = method.ask(problem, self._state)
        self.inference: Inference[Inferred] | None = None
        self._trained: TrainedPolicy | None = None
        self._before: TrainedPolicy | None = None  # for the distribution before the present one
        self._seen: list[tuple[bytes, TransitionDataset]] = []  # visits that were learnt from

    def train(self) -> Generator[RunEvent, None, TrainedPolicy]:
        """Train a policy for the present distribution.

        Until `update` changes that, further calls ask for the same stage.
        """
        stage = training(self._spec, self.distribution, self._before)
        self._trained = yield from self._stages.run(stage)
        return self._trained

    def visit(self, trained: TrainedPolicy, iteration: int) -> Generator[RunEvent, None, Visit]:
        """A trajectory of a policy on the target."""
        return (yield from self.target.rollout(trained.policy, iteration))

    def update(self, visits: Sequence[Visit]) -> Generator[RunEvent, None, None]:
        """Infer from visits of one policy."""
        policy, data = visits[0].policy, joined(visits)
        assert policy is not None, "an online method learns from its own policies"
        self.inference = yield from infer(
            self._spec,
            self._stages,
            state=self._state,
            policy=policy,
            data=data,
            earlier=packed(self._seen) if self._seen else None,
        )
        if self._spec.method.remembers:
            self._seen += [(policy, visit.data) for visit in visits]
        answer = self.inference.answer
        assert answer.state is not None, "an online method has a state"
        self._state, self.distribution = answer.state, answer.distribution
        self._before = self._trained

"""Methods that learn from returns: those of UDR's policies, then of one more per iteration.

An iteration reports the cost of the proposal made after its returns. The first proposal, made from
the returns of UDR's policies alone, is reported in no iteration.
"""

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import cast

from adr_service.distributions import Distribution
from adr_service.events import RunEvent
from adr_service.methods.base import ReturnsSettings
from adr_service.methods.catalogue import method_inputs
from adr_service.methods.udr import UdrSettings
from adr_service.programs.steps import Inference, evaluate_and_report, source_inputs, training
from adr_service.programs.udr import boxes_of
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.stages.propose import Propose, Proposed
from adr_service.target import open_target


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    settings = cast(ReturnsSettings, spec.method)
    target = open_target(spec, stages)
    tried: list[Distribution] = [*boxes_of(spec, UdrSettings(policies=settings.initial))]
    trainings = [training(spec, box) for box in tried]
    trained = yield from stages.all(trainings)
    returns = yield from target.returns([each.policy for each in trained], 0)
    yield from evaluate_and_report(target, 0, tried, trained)
    proposal, _ = yield from _propose(spec, stages, tried, returns)
    for iteration in range(1, spec.iterations + 1):
        tried.append(proposal.distribution)
        trainings.append(training(spec, tried[-1], trained[-1]))
        trained.append((yield from stages.run(trainings[-1])))
        returns += yield from target.returns([trained[-1].policy], iteration)
        proposal, digest = yield from _propose(spec, stages, tried, returns)
        best, reported = tried[proposal.best], trained[proposal.best]
        if settings.report == "retrained":
            reported = yield from stages.run(replace(trainings[proposal.best], repeat=1))
        inference = Inference(proposal, [digest])
        yield from evaluate_and_report(target, iteration, [best], [reported], inference)


def _propose(
    spec: RunSpec, stages: Stages, tried: Sequence[Distribution], returns: Sequence[float]
) -> Generator[RunEvent, None, tuple[Proposed, str]]:
    """The proposal after these returns, and the digest of its stage."""
    stage = Propose(
        **source_inputs(spec),
        method=spec.method.model_dump(exclude={"report"}),  # which changes no proposal
        method_package=method_inputs(spec.method)["method_package"],
        distributions=list(tried),
        returns=list(returns),
    )
    return (yield from stages.run(stage)), stage.digest

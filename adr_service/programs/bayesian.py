"""BayRn: UDR's policies and their target returns, then one more policy per iteration."""

from collections.abc import Generator, Sequence
from dataclasses import replace

from adr_service.distributions import Uniform
from adr_service.events import RunEvent
from adr_service.methods.bayrn import BayRnSettings
from adr_service.methods.udr import UdrSettings
from adr_service.programs.steps import Inference, evaluate_and_report, source_inputs, training
from adr_service.programs.udr import boxes_of
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.stages.propose import Propose, Proposed
from adr_service.target import open_target


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    settings = BayRnSettings.model_validate(spec.method)
    target = open_target(spec, stages)
    boxes = boxes_of(spec, UdrSettings(policies=settings.initial))
    trainings = [training(spec, box) for box in boxes]
    trained = yield from stages.all(trainings)
    returns = yield from target.returns([each.policy for each in trained], 0)
    yield from evaluate_and_report(target, 0, boxes, trained)
    proposal, _ = yield from _propose(spec, stages, boxes, returns)
    for iteration in range(1, spec.iterations + 1):
        box = proposal.distribution
        assert isinstance(box, Uniform)
        boxes.append(box)
        trainings.append(training(spec, box, trained[-1]))
        trained.append((yield from stages.run(trainings[-1])))
        returns += yield from target.returns([trained[-1].policy], iteration)
        proposal, digest = yield from _propose(spec, stages, boxes, returns)
        best, reported = boxes[proposal.best], trained[proposal.best]
        if settings.report == "retrained":
            reported = yield from stages.run(replace(trainings[proposal.best], repeat=1))
        inference = Inference(proposal, [digest])
        yield from evaluate_and_report(target, iteration, [best], [reported], inference)


def _propose(
    spec: RunSpec, stages: Stages, boxes: Sequence[Uniform], returns: Sequence[float]
) -> Generator[RunEvent, None, tuple[Proposed, str]]:
    """The proposal after these returns, and the digest of its stage."""
    stage = Propose(
        **source_inputs(spec),
        method=spec.method.model_dump(exclude={"report"}),  # which changes no proposal
        distributions=list(boxes),
        returns=list(returns),
    )
    return (yield from stages.run(stage)), stage.digest

"""SimOpt-1: ever more trajectories of the prior's policy, and one inference from the prior."""

from collections.abc import Generator

from adr_service.events import RunEvent
from adr_service.programs.online import OnlineLoop
from adr_service.programs.steps import evaluate_and_report
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.target import Visit, open_target


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    loop = OnlineLoop(spec, stages, open_target(spec, stages))
    collecting = yield from loop.train()
    yield from evaluate_and_report(loop.target, 0, [loop.distribution], [collecting])
    visits: list[Visit] = []
    for iteration in range(1, spec.iterations + 1):
        visits.append((yield from loop.visit(collecting, iteration - 1)))
        fresh = OnlineLoop(spec, stages, loop.target)
        yield from fresh.update(visits)
        trained = yield from fresh.train()
        yield from evaluate_and_report(
            loop.target, iteration, [fresh.distribution], [trained], fresh.inference
        )

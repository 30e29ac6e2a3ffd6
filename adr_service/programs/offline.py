"""Offline methods: data -> estimate -> train once -> evaluate on the target.

They learn from the trajectories that SimOpt collects with the same seed (benchmark, Sec. 3.4), by
running SimOpt's own stages: whoever comes first computes them for both. In the data-collection
study others collect.
"""

from collections.abc import Generator, Sequence

from adr_service.distributions import Gaussian
from adr_service.events import RunEvent
from adr_service.methods.simopt import SimOptSettings
from adr_service.programs.online import OnlineLoop
from adr_service.programs.steps import evaluate_and_report, infer, joined, problem_of, training
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.target import Recording, Target, Visit, open_target


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    target = open_target(spec, stages)
    # whoever collects, the first policy is the prior's
    simopt = spec.simopt or SimOptSettings.model_validate({})
    collector = OnlineLoop(spec.model_copy(update={"method": simopt}), stages, target)
    prior = Gaussian.prior(problem_of(spec).source.space)
    trained = yield from stages.run(training(spec, prior))
    yield from evaluate_and_report(target, 0, [prior], [trained])
    visits: list[Visit] = []
    for iteration in range(1, spec.iterations + 1):
        visits.append((yield from _collect(spec, collector, visits)))
        yield from estimate_and_report(spec, stages, target, iteration, joined(visits))


def estimate_and_report(
    spec: RunSpec, stages: Stages, target: Target | Recording, iteration: int, data: bytes
) -> Generator[RunEvent, None, None]:
    """Infer from the data, train on the estimate and report."""
    inference = yield from infer(spec, stages, data=data)
    estimate = inference.answer.distribution
    trained = yield from stages.run(training(spec, estimate))
    yield from evaluate_and_report(target, iteration, [estimate], [trained], inference)


def _collect(
    spec: RunSpec, collector: OnlineLoop, visits: Sequence[Visit]
) -> Generator[RunEvent, None, Visit]:
    """One more visit for an offline method, after `visits`."""
    if spec.collector == "random":
        return (yield from collector.target.rollout(None, len(visits)))
    if spec.collector == "random_matched":
        return (yield from collector.target.random_episodes())
    if spec.collector == "simopt" and visits:
        yield from collector.update(visits[-1:])
    collecting = yield from collector.train()
    return (yield from collector.visit(collecting, len(visits)))

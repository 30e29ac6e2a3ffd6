"""A run: the straight-line program that the paper's figure draws, as a generator of events.

    for event in run(spec, LocalStages()):
        print(event)

offline (UDR, DROID, DROPO, sysid): data -> estimate -> train once -> evaluate on the target
online (BayRn, SimOpt):             repeat: train -> visit the target -> update the estimate

The same program runs in the service, in tests and in a debugger; `stages` alone differs.
Offline methods learn from the trajectories that SimOpt collects with the same seed (benchmark,
Sec. 3.4), by running SimOpt's own stages: whoever comes first computes them for both.
"""

from collections.abc import Generator, Sequence
from typing import Any

import numpy as np

from adr_service.distributions import Distribution, Gaussian, Uniform, distribution_from_json
from adr_service.events import IterationFinished, RunEvent
from adr_service.methods import online
from adr_service.methods.base import Problem
from adr_service.methods.bayrn import BayRnSettings
from adr_service.methods.droid import DroidSettings
from adr_service.methods.dropo import DropoSettings
from adr_service.methods.references import OracleSettings, PriorSettings
from adr_service.methods.simopt import SimOpt1Settings, SimOptSettings
from adr_service.methods.sysid import SysidSettings
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.presets import PRESETS
from adr_service.randomness import stream
from adr_service.specs import RunSpec
from adr_service.stages import Stage, StageResult, Stages
from adr_service.target import Target, Visit, truth_as_distribution
from adr_service.tasks.catalogue import get_task, identity_of, source_of
from adr_service.transitions import TransitionDataset
from adr_service.wire import sha256

Program = Generator[RunEvent, None, None]


def run(spec: RunSpec, stages: Stages) -> Program:
    """Everything that happens in a run, in order; ends when the run has succeeded."""
    match spec.method:
        case SimOptSettings():
            yield from _online(spec, stages)
        case BayRnSettings(initial=initial):
            yield from _bayesian(spec, stages, UdrSettings(policies=initial))
        case SimOpt1Settings():
            yield from _single_shot(spec, stages)
        case DropoSettings() | DroidSettings() | SysidSettings():
            yield from _offline(spec, stages)
        case UdrSettings():
            yield from _train_and_report(spec, stages, _boxes(spec, spec.method))
        case PriorSettings():
            prior = Gaussian.prior(_problem(spec).source.space)
            yield from _train_and_report(spec, stages, [prior])
        case OracleSettings():
            truth = truth_as_distribution(spec.task, spec.variant)
            yield from _train_and_report(spec, stages, [truth], variant="vanilla")


def _online(spec: RunSpec, stages: Stages) -> Program:
    loop = _OnlineLoop(spec, stages, Target(spec, stages))
    for iteration in range(spec.iterations + 1):
        trained = yield from loop.train()
        yield from _report(spec, loop.target, iteration, [loop.distribution], [trained], loop.last)
        if iteration < spec.iterations:
            visit = yield from loop.visit(trained, iteration)
            yield from loop.update([visit])


def _offline(spec: RunSpec, stages: Stages) -> Program:
    target = Target(spec, stages)
    collector = _OnlineLoop(spec.model_copy(update={"method": _collector(spec)}), stages, target)
    prior = Gaussian.prior(_problem(spec).source.space)
    trained = yield from stages.run(_training(spec, prior))
    yield from _report(spec, target, 0, [prior], [trained])
    visits: list[Visit] = []
    for iteration in range(1, spec.iterations + 1):
        if iteration > 1:
            yield from collector.update(visits[-1:])
        collecting = yield from collector.train()
        visits.append((yield from collector.visit(collecting, iteration - 1)))
        inferred = yield from _estimate(spec, stages, _joined(visits))
        distribution = _decode(spec, inferred.values["distribution"])
        trained = yield from stages.run(_training(spec, distribution))
        yield from _report(spec, target, iteration, [distribution], [trained], inferred)


def _estimate(spec: RunSpec, stages: Stages, data: bytes) -> Generator[RunEvent, None, StageResult]:
    """What an offline method infers; of several epsilons, by the one that predicts best.

    DROPO, Sec. IV-A: the mean squared error of one-step predictions by the estimate's mean.
    """
    method = spec.method
    each = method.each() if isinstance(method, DropoSettings) else [method]
    inputs = [{**_identity(spec), "method": settings.model_dump()} for settings in each]
    results = yield from stages.all([Stage("infer", given, {"data": data}) for given in inputs])
    if len(results) == 1:
        return results[0]
    errors = [result.values["diagnostics"]["mean_squared_error"] for result in results]
    best = results[int(np.argmin(errors))]
    tried = {
        str(result.values["diagnostics"]["epsilon"]): error
        for result, error in zip(results, errors, strict=True)
    }
    values = {
        **best.values,
        "simulated_steps": sum(result.values["simulated_steps"] for result in results),
        "diagnostics": {**best.values["diagnostics"], "mean_squared_error_by_epsilon": tried},
    }
    return StageResult(values, best.blobs)


def _single_shot(spec: RunSpec, stages: Stages) -> Program:
    """SimOpt-1: ever more trajectories of the prior's policy, and one inference from the prior."""
    loop = _OnlineLoop(spec, stages, Target(spec, stages))
    collecting = yield from loop.train()
    yield from _report(spec, loop.target, 0, [loop.distribution], [collecting])
    visits: list[Visit] = []
    for iteration in range(1, spec.iterations + 1):
        visits.append((yield from loop.visit(collecting, iteration - 1)))
        fresh = _OnlineLoop(spec, stages, loop.target)
        yield from fresh.update(visits)
        trained = yield from fresh.train()
        yield from _report(
            spec, loop.target, iteration, [fresh.distribution], [trained], fresh.last
        )


def _bayesian(spec: RunSpec, stages: Stages, start: UdrSettings) -> Program:
    """BayRn: UDR's policies and their target returns, then one more policy per iteration."""
    target, boxes = Target(spec, stages), _boxes(spec, start)
    trained = yield from stages.all([_training(spec, box) for box in boxes])
    returns = yield from target.returns([result.blobs["policy"] for result in trained], 0)
    yield from _report(spec, target, 0, boxes, trained)
    proposal = yield from _propose(spec, stages, boxes, returns)
    for iteration in range(1, spec.iterations + 1):
        box = _decode(spec, proposal.values["distribution"])
        assert isinstance(box, Uniform)
        boxes.append(box)
        trained.append((yield from stages.run(_training(spec, box))))
        policy = trained[-1].blobs["policy"]
        returns += yield from target.returns([policy], iteration)
        proposal = yield from _propose(spec, stages, boxes, returns)
        best = proposal.values["best"]
        yield from _report(spec, target, iteration, [boxes[best]], [trained[best]], proposal)


def _propose(
    spec: RunSpec, stages: Stages, boxes: Sequence[Uniform], returns: Sequence[float]
) -> Generator[RunEvent, None, StageResult]:
    inputs = {
        **_identity(spec),
        "method": spec.method.model_dump(),
        "distributions": [box.to_json() for box in boxes],
        "returns": list(returns),
    }
    return (yield from stages.run(Stage("propose", inputs)))


def _boxes(spec: RunSpec, settings: UdrSettings) -> list[Uniform]:
    """UDR's random bounds for a seed."""
    rng = stream("udr", spec.task, spec.variant, spec.seed)
    return random_bounds(_problem(spec).source.space, settings, rng)


def _joined(visits: Sequence[Visit]) -> bytes:
    """The transitions of several visits, one episode each."""
    parts = [TransitionDataset.from_npz(visit.data) for visit in visits]
    return TransitionDataset.concatenate(parts).to_npz()


def _train_and_report(
    spec: RunSpec,
    stages: Stages,
    distributions: Sequence[Distribution],
    variant: str | None = None,
) -> Program:
    """For methods without data: one policy per distribution, all at the same time."""
    trained = yield from stages.all([_training(spec, d, variant) for d in distributions])
    yield from _report(spec, Target(spec, stages), 0, distributions, trained)


class _OnlineLoop:
    """One online method at work: what it is about to train on, and what it saw last."""

    def __init__(self, spec: RunSpec, stages: Stages, target: Target):
        self._spec, self._stages, self.target = spec, stages, target
        self._method, self._problem = online(spec.method), _problem(spec)
        self._state = self._method.start(self._problem)
        self.last: StageResult | None = None  # of the latest inference

    @property
    def distribution(self) -> Distribution:
        return self._method.ask(self._problem, self._state)

    def train(self) -> Generator[RunEvent, None, StageResult]:
        return (yield from self._stages.run(_training(self._spec, self.distribution)))

    def visit(self, trained: StageResult, iteration: int) -> Generator[RunEvent, None, Visit]:
        return (yield from self.target.rollout(trained.blobs["policy"], iteration))

    def update(self, visits: Sequence[Visit]) -> Program:
        """Infer from visits of one policy."""
        self.last = yield from self._stages.run(
            Stage(
                "infer",
                {
                    **_identity(self._spec),
                    "method": self._spec.method.model_dump(),
                    "state": self._state,
                },
                {"policy": visits[0].policy, "data": _joined(visits)},
            )
        )
        self._state = self.last.values["state"]


def _report(
    spec: RunSpec,
    target: Target,
    iteration: int,
    distributions: Sequence[Distribution],
    trained: Sequence[StageResult],
    inferred: StageResult | None = None,
) -> Program:
    """Evaluate the trained policies on the target and say how it stands."""
    policies = [result.blobs["policy"] for result in trained]
    found = yield from target.evaluate(policies)
    returns = [values["returns"] for values in found]
    yield IterationFinished(
        iteration=iteration,
        target_rollouts=target.rollouts,
        target_transitions=target.transitions,
        evaluation_episodes=sum(len(episodes) for episodes in returns),
        distributions=[distribution.to_json() for distribution in distributions],
        policies=[sha256(policy) for policy in policies],
        source_returns=[result.values["source_return"] for result in trained],
        reached_threshold=[result.values["reached_threshold"] for result in trained],
        training_steps=[result.values["steps"] for result in trained],
        inference_steps=inferred.values["simulated_steps"] if inferred else 0,
        returns=returns,
        diverged_episodes=sum(values["diverged_episodes"] for values in found),
        diagnostics=inferred.values["diagnostics"] if inferred else {},
    )


def _training(spec: RunSpec, distribution: Distribution, variant: str | None = None) -> Stage:
    inputs: dict[str, Any] = {
        **_identity(spec),
        "variant": variant or spec.variant,
        "distribution": distribution.to_json(),
        "training": spec.training.model_dump(),
    }
    return Stage("train_policy", inputs)


def _identity(spec: RunSpec) -> dict[str, Any]:
    return {**identity_of(spec.task), "variant": spec.variant, "seed": spec.seed}


def _collector(spec: RunSpec) -> SimOptSettings:
    """The SimOpt whose trajectories offline methods read: the preset's."""
    return SimOptSettings.model_validate(PRESETS[spec.preset]["methods"].get("simopt", {}))


def _problem(spec: RunSpec) -> Problem:
    task = get_task(spec.task)
    return Problem(task, source_of(task.name, spec.variant))


def _decode(spec: RunSpec, document: dict[str, Any]) -> Distribution:
    return distribution_from_json(_problem(spec).source.space, document)

"""A run: the straight-line program that the paper's figure draws, as a generator of events.

    for event in run(spec, LocalStages()):
        print(event)

offline (UDR, DROID, DROPO, sysid): data -> estimate -> train once -> evaluate on the target
online (BayRn, SimOpt):             repeat: train -> visit the target -> update the estimate

The same program runs in the service, in tests and in a debugger; `stages` alone differs.
Offline methods learn from the trajectories that SimOpt collects with the same seed (benchmark,
Sec. 3.4), by running SimOpt's own stages: whoever comes first computes them for both. In the
data-collection study others collect. With a recorded target there is nothing to visit or to
evaluate on, and the answer is the estimate and a policy.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adr_service.distributions import Distribution, Gaussian, Uniform, distribution_from_json
from adr_service.errors import InvalidInput
from adr_service.events import CriticismFinished, IterationFinished, RunEvent
from adr_service.json_values import sha256
from adr_service.methods.base import OfflineSettings, OnlineSettings, Problem
from adr_service.methods.bayrn import BayRnSettings
from adr_service.methods.catalogue import identity_of as identity_of_method
from adr_service.methods.dropo import DropoSettings
from adr_service.methods.references import OracleSettings, PriorSettings
from adr_service.methods.simopt import SimOpt1Settings, SimOptSettings
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.randomness import stream
from adr_service.specs import AnyRun, CriticismSpec, RecordedTarget, RunSpec
from adr_service.stages import Stage, StageResult, Stages
from adr_service.target import Recording, Target, Visit, open_target, truth_as_distribution
from adr_service.tasks.catalogue import get_task, identity_of, source_of
from adr_service.transitions import TransitionDataset

Program = Generator[RunEvent, None, None]


@dataclass(frozen=True)
class _Inference:
    """What an inference found, and the digests of the stages that found it."""

    values: dict[str, Any]
    stages: list[str]


def run(spec: AnyRun, stages: Stages, recording: bytes | None = None) -> Program:
    """Everything that happens in a run, in order; ends when the run has succeeded.

    `recording` is the `.npz` of the dataset that a spec names.
    """
    if isinstance(spec, CriticismSpec):
        yield from _criticise(spec, stages, recording)
        return
    if isinstance(spec.target, RecordedTarget):
        yield from _recorded(spec, stages, Recording(spec, recording))
        return
    match spec.method:
        case BayRnSettings(initial=initial):
            yield from _bayesian(spec, stages, UdrSettings(policies=initial))
        case SimOpt1Settings():
            yield from _single_shot(spec, stages)
        case OnlineSettings():
            yield from _online(spec, stages)
        case OfflineSettings():
            yield from _offline(spec, stages)
        case UdrSettings():
            yield from _train_and_report(spec, stages, _boxes(spec, spec.method))
        case PriorSettings():
            prior = Gaussian.prior(_problem(spec).source.space)
            yield from _train_and_report(spec, stages, [prior])
        case OracleSettings():
            truth = truth_as_distribution(spec.task, spec.variant)
            trained = yield from stages.run(oracle_training(spec))
            yield from _report(spec, open_target(spec, stages), 0, [truth], [trained])
        case _:
            raise InvalidInput(f"no program runs the method {spec.method.name}")


def _criticise(spec: CriticismSpec, stages: Stages, measurement: bytes | None) -> Program:
    """What the simulator gets wrong; one stage, of whose parts none would be worth sharing."""
    if measurement is None:
        raise InvalidInput(f"the measurement {spec.dataset} was not given")
    inputs = {**identity_of(spec.task), "variant": spec.variant, "seed": spec.seed}
    result = yield from stages.run(Stage("criticise", inputs, {"data": measurement}))
    files = {name: sha256(content) for name, content in result.blobs.items()}
    yield CriticismFinished(verdict=result.values["verdict"], files=files)


def _online(spec: RunSpec, stages: Stages) -> Program:
    loop = _OnlineLoop(spec, stages, open_target(spec, stages))
    for iteration in range(spec.iterations + 1):
        trained = yield from loop.train()
        yield from _report(spec, loop.target, iteration, [loop.distribution], [trained], loop.last)
        if iteration < spec.iterations:
            visit = yield from loop.visit(trained, iteration)
            yield from loop.update([visit])


def _offline(spec: RunSpec, stages: Stages) -> Program:
    target = open_target(spec, stages)
    # whoever collects, the first policy is the prior's
    simopt = spec.simopt or SimOptSettings.model_validate({})
    collector = _OnlineLoop(spec.model_copy(update={"method": simopt}), stages, target)
    prior = Gaussian.prior(_problem(spec).source.space)
    trained = yield from stages.run(_training(spec, prior))
    yield from _report(spec, target, 0, [prior], [trained])
    visits: list[Visit] = []
    for iteration in range(1, spec.iterations + 1):
        visits.append((yield from _collect(spec, collector, visits)))
        yield from _estimate_and_report(spec, stages, target, iteration, _joined(visits))


def _collect(
    spec: RunSpec, collector: "_OnlineLoop", visits: Sequence[Visit]
) -> Generator[RunEvent, None, Visit]:
    """One more trajectory for an offline method, after `visits`."""
    if spec.collector == "random":
        return (yield from collector.target.rollout(None, len(visits)))
    if spec.collector == "simopt" and visits:
        yield from collector.update(visits[-1:])
    collecting = yield from collector.train()
    return (yield from collector.visit(collecting, len(visits)))


def _recorded(spec: RunSpec, stages: Stages, recording: Recording) -> Program:
    yield from _estimate_and_report(spec, stages, recording, 1, recording.data)


def _estimate_and_report(
    spec: RunSpec, stages: Stages, target: Target | Recording, iteration: int, data: bytes
) -> Program:
    inferred = yield from _estimate(spec, stages, data)
    distribution = _decode(spec, inferred.values["distribution"])
    trained = yield from stages.run(_training(spec, distribution))
    yield from _report(spec, target, iteration, [distribution], [trained], inferred)


def _estimate(spec: RunSpec, stages: Stages, data: bytes) -> Generator[RunEvent, None, _Inference]:
    """What an offline method infers; of several epsilons, by the one that predicts best.

    DROPO, Sec. IV-A: the mean squared error of one-step predictions by the estimate's mean.
    """
    method = spec.method
    each = method.each() if isinstance(method, DropoSettings) else [method]
    inputs = [{**_identity(spec), **identity_of_method(settings)} for settings in each]
    asked = [Stage("infer", given, {"data": data}) for given in inputs]
    results = yield from stages.all(asked)
    digests = [stage.digest for stage in asked]
    if len(results) == 1:
        return _Inference(results[0].values, digests)
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
    return _Inference(values, digests)


def _single_shot(spec: RunSpec, stages: Stages) -> Program:
    """SimOpt-1: ever more trajectories of the prior's policy, and one inference from the prior."""
    loop = _OnlineLoop(spec, stages, open_target(spec, stages))
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
    target, boxes = open_target(spec, stages), _boxes(spec, start)
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
) -> Generator[RunEvent, None, _Inference]:
    inputs = {
        **_identity(spec),
        **identity_of_method(spec.method),
        "distributions": [box.to_json() for box in boxes],
        "returns": list(returns),
    }
    stage = Stage("propose", inputs)
    result = yield from stages.run(stage)
    return _Inference(result.values, [stage.digest])


def _boxes(spec: RunSpec, settings: UdrSettings) -> list[Uniform]:
    """UDR's random bounds for a seed."""
    rng = stream("udr", spec.task, spec.source_domain, spec.seed)
    return random_bounds(_problem(spec).source.space, settings, rng)


def _joined(visits: Sequence[Visit]) -> bytes:
    """The transitions of several visits, one episode each."""
    parts = [TransitionDataset.from_npz(visit.data) for visit in visits]
    return TransitionDataset.concatenate(parts).to_npz()


def _train_and_report(
    spec: RunSpec, stages: Stages, distributions: Sequence[Distribution]
) -> Program:
    """For methods without data: one policy per distribution, all at the same time."""
    trained = yield from stages.all([_training(spec, d) for d in distributions])
    yield from _report(spec, open_target(spec, stages), 0, distributions, trained)


class _OnlineLoop:
    """One online method at work: what it is about to train on, and what it saw last."""

    def __init__(self, spec: RunSpec, stages: Stages, target: Target):
        self._spec, self._stages, self.target = spec, stages, target
        assert isinstance(spec.method, OnlineSettings)
        self._method, self._problem = spec.method.create(), _problem(spec)
        self._state = self._method.start(self._problem)
        self.last: _Inference | None = None

    @property
    def distribution(self) -> Distribution:
        return self._method.ask(self._problem, self._state)

    def train(self) -> Generator[RunEvent, None, StageResult]:
        return (yield from self._stages.run(_training(self._spec, self.distribution)))

    def visit(self, trained: StageResult, iteration: int) -> Generator[RunEvent, None, Visit]:
        return (yield from self.target.rollout(trained.blobs["policy"], iteration))

    def update(self, visits: Sequence[Visit]) -> Program:
        """Infer from visits of one policy."""
        policy = visits[0].policy
        assert policy is not None
        stage = Stage(
            "infer",
            {
                **_identity(self._spec),
                **identity_of_method(self._spec.method),
                "state": self._state,
            },
            {"policy": policy, "data": _joined(visits)},
        )
        result = yield from self._stages.run(stage)
        self.last, self._state = _Inference(result.values, [stage.digest]), result.values["state"]


def _report(
    spec: RunSpec,
    target: Target | Recording,
    iteration: int,
    distributions: Sequence[Distribution],
    trained: Sequence[StageResult],
    inferred: _Inference | None = None,
) -> Program:
    """Evaluate the trained policies on the target, where that can be, and say how it stands."""
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
        inferences=inferred.stages if inferred else [],
        returns=returns,
        diverged_episodes=sum(values["diverged_episodes"] for values in found),
        diagnostics=inferred.values["diagnostics"] if inferred else {},
    )


def oracle_training(spec: RunSpec) -> Stage:
    """The training on the target's truth, in whose own space it is: the vanilla variant's."""
    truth = truth_as_distribution(spec.task, spec.variant)
    target = spec.model_copy(update={"variant": "vanilla", "extension": spec.hidden_effects})
    return _training(target, truth)


def _training(spec: RunSpec, distribution: Distribution) -> Stage:
    inputs: dict[str, Any] = {
        **_identity(spec),
        "distribution": distribution.to_json(),
        "training": spec.training.model_dump(),
    }
    return Stage("train_policy", inputs)


def _identity(spec: RunSpec) -> dict[str, Any]:
    return {**identity_of(spec.task), "variant": spec.source_domain, "seed": spec.seed}


def _problem(spec: RunSpec) -> Problem:
    task = get_task(spec.task)
    return Problem(task, source_of(task.name, spec.source_domain))


def _decode(spec: RunSpec, document: dict[str, Any]) -> Distribution:
    return distribution_from_json(_problem(spec).source.space, document)

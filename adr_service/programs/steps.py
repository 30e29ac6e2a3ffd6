"""Steps that programs share: train, infer, and report how a run stands."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from adr_service.distributions import Distribution, at_resolution
from adr_service.errors import InvalidInput
from adr_service.events import IterationFinished, RunEvent
from adr_service.json_values import sha256
from adr_service.methods.base import Problem
from adr_service.methods.catalogue import method_inputs
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.stages.infer import Infer, Inferred
from adr_service.stages.propose import Proposed
from adr_service.stages.smooth_states import SmoothStates
from adr_service.stages.train_policy import TrainedPolicy, TrainPolicy
from adr_service.target import Recording, Target, Visit
from adr_service.tasks.catalogue import get_task, source_of, task_inputs
from adr_service.transitions import TransitionDataset

Answer = TypeVar("Answer", Inferred, Proposed)


@dataclass(frozen=True)
class Inference(Generic[Answer]):
    """An answer of a method, and the digests of the stages that computed it."""

    answer: Answer
    digests: list[str]


def problem_of(spec: RunSpec) -> Problem:
    """The simulator that the method of a run may use."""
    task = get_task(spec.task)
    return Problem(task, source_of(task.name, spec.source_domain))


def source_inputs(spec: RunSpec) -> dict[str, Any]:
    """The inputs of every stage that simulates the source."""
    return {**task_inputs(spec.task), "variant": spec.source_domain, "seed": spec.seed}


def training(
    spec: RunSpec, distribution: Distribution, previous: TrainedPolicy | None = None
) -> TrainPolicy:
    """The training of a run's policy on a distribution.

    It starts from the networks of the run's previous policy, if the run's settings want that.
    Variants with one source share it, and beliefs that are one point at the spec's resolution.
    """
    if spec.resolution is not None:
        distribution = at_resolution(distribution, spec.resolution)
    source: dict[str, Any] = {**source_inputs(spec), "variant": spec.training_domain}
    return TrainPolicy(
        **source,
        distribution=distribution,
        training=spec.training,
        start=None if previous is None else previous.networks,
    )


def infer(
    spec: RunSpec,
    stages: Stages,
    *,
    data: bytes,
    policy: bytes | None = None,
    state: dict[str, Any] | None = None,
    earlier: bytes | None = None,
) -> Generator[RunEvent, None, Inference[Inferred]]:
    """The answer of a run's method; if its settings have a grid, the best of all answers.

    An online method needs its state, and the policy that made the data; one that remembers, also
    the visits before (`stages.infer.packed`).
    """
    if spec.method.replay_from == "smoothed":
        return (yield from _infer_from_smoothed(spec, stages, data))
    return (yield from _infer(spec, stages, data, policy, state, earlier))


def _infer_from_smoothed(
    spec: RunSpec, stages: Stages, data: bytes
) -> Generator[RunEvent, None, Inference[Inferred]]:
    """The answer of an offline method from smoothed states, with what the smoothing found."""
    smoothing = SmoothStates(**source_inputs(spec), data=data)
    states = yield from stages.run(smoothing)
    inference = yield from _infer(spec, stages, states.data)
    found = {"parameters": states.parameters, "sensor_std": states.sensor_std}
    answer = inference.answer.model_copy(
        update={
            "simulated_steps": states.simulated_steps + inference.answer.simulated_steps,
            "diagnostics": {**inference.answer.diagnostics, "smoothing": found},
        }
    )
    return Inference(answer, [smoothing.digest, *inference.digests])


def _infer(
    spec: RunSpec,
    stages: Stages,
    data: bytes,
    policy: bytes | None = None,
    state: dict[str, Any] | None = None,
    earlier: bytes | None = None,
) -> Generator[RunEvent, None, Inference[Inferred]]:
    """The answer of a run's method to data as they are."""
    asked = [
        Infer(
            **source_inputs(spec),
            **method_inputs(settings),
            data=data,
            policy=policy,
            state=state,
            earlier=earlier,
        )
        for settings in spec.method.each
    ]
    answers = yield from stages.all(asked)
    digests = [stage.digest for stage in asked]
    if len(answers) == 1:
        return Inference(answers[0], digests)
    return Inference(_best(spec, asked, answers), digests)


def _best(spec: RunSpec, asked: Sequence[Infer], answers: Sequence[Inferred]) -> Inferred:
    """The grid's best answer, and in its diagnostics the criterion of each."""
    grid = spec.method.grid
    assert grid is not None
    if any(grid.criterion not in answer.diagnostics for answer in answers):
        raise InvalidInput(
            f"{spec.method.name} chooses among several values of {grid.field} by the diagnostic "
            f"{grid.criterion!r}, which its estimates do not have"
        )
    criteria = [answer.diagnostics[grid.criterion] for answer in answers]
    best = answers[grid.best(criteria)]
    values = [str(getattr(stage.method, grid.field)) for stage in asked]
    tried = dict(zip(values, criteria, strict=True))
    return best.model_copy(
        update={
            "simulated_steps": sum(answer.simulated_steps for answer in answers),
            "diagnostics": {**best.diagnostics, f"{grid.criterion}_by_{grid.field}": tried},
        }
    )


def joined(visits: Sequence[Visit]) -> bytes:
    """The transitions of several visits."""
    return TransitionDataset.concatenate([visit.data for visit in visits]).to_npz()


def evaluate_and_report(
    target: Target | Recording,
    iteration: int,
    distributions: Sequence[Distribution],
    trained: Sequence[TrainedPolicy],
    inference: Inference[Inferred] | Inference[Proposed] | None = None,
) -> Generator[RunEvent, None, None]:
    """Evaluate the trained policies on the target, where that is possible, and report them."""
    policies = [each.policy for each in trained]
    evaluations = yield from target.evaluate(policies)
    returns = [evaluation.returns for evaluation in evaluations]
    yield IterationFinished(
        iteration=iteration,
        target_rollouts=target.rollouts,
        target_transitions=target.transitions,
        evaluation_episodes=sum(len(episodes) for episodes in returns),
        distributions=[distribution.to_json() for distribution in distributions],
        policies=[sha256(policy) for policy in policies],
        source_returns=[each.source_return for each in trained],
        reached_threshold=[each.reached_threshold for each in trained],
        training_steps=[each.steps for each in trained],
        inference_steps=inference.answer.simulated_steps if inference else 0,
        inferences=inference.digests if inference else [],
        returns=returns,
        diverged_episodes=sum(evaluation.diverged_episodes for evaluation in evaluations),
        diagnostics=inference.answer.diagnostics if inference else {},
    )

"""The references of a benchmark: policies trained on the prior, and on the hidden truth."""

from collections.abc import Generator

from adr_service.distributions import Gaussian, Uniform
from adr_service.events import RunEvent
from adr_service.programs.steps import evaluate_and_report, problem_of, training
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.stages.train_policy import TrainPolicy
from adr_service.target import open_target
from adr_service.tasks.catalogue import hidden_of


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    stage = reference_training(spec)
    trained = yield from stages.run(stage)
    yield from evaluate_and_report(open_target(spec, stages), 0, [stage.distribution], [trained])


def reference_training(spec: RunSpec) -> TrainPolicy:
    """The training of the reference that a run is: the prior, or the hidden truth."""
    return truth_training(spec) if spec.method.needs_truth else prior_training(spec)


def prior_training(spec: RunSpec) -> TrainPolicy:
    return training(spec, Gaussian.prior(problem_of(spec).source.space))


def truth_training(spec: RunSpec) -> TrainPolicy:
    """The training on the target's truth, in whose own space it is: the vanilla variant's."""
    target = spec.model_copy(update={"variant": "vanilla", "extension": spec.hidden_effects})
    return training(target, truth_of(spec.task, spec.variant))


def truth_of(task: str, variant: str) -> Uniform:
    """Certainty about the truth, in the target's own space."""
    hidden = hidden_of(task, variant)
    return Uniform.point(hidden.source.space, hidden.values)

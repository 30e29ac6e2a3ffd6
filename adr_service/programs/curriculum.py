"""Curricula: one policy, trained on a distribution that moves, without any data of the target.

The run reports the distribution of the training's last phase, and the policy of its best
evaluation on the whole search box.
"""

from collections.abc import Generator
from dataclasses import replace
from typing import cast

from adr_service.distributions import Uniform, distribution_from_json
from adr_service.events import RunEvent
from adr_service.methods.base import CurriculumSettings
from adr_service.methods.catalogue import method_inputs
from adr_service.programs.steps import evaluate_and_report, problem_of, training
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.stages.train_policy import TrainPolicy
from adr_service.target import open_target


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    stage = curriculum_training(spec)
    trained = yield from stages.run(stage)
    assert trained.phases is not None, "a training with a curriculum has phases"
    last = distribution_from_json(stage.distribution.space, trained.phases[-1].distribution)
    yield from evaluate_and_report(open_target(spec, stages), 0, [last], [trained])


def curriculum_training(spec: RunSpec) -> TrainPolicy:
    """The training with a run's curriculum, whose policy is judged on the whole search box."""
    space = problem_of(spec).source.space
    known = method_inputs(spec.method)
    return replace(
        training(spec, Uniform(space, space.low, space.high)),
        curriculum=cast(CurriculumSettings, known["method"]),
        curriculum_package=known["method_package"],
    )

"""Curricula: one policy, trained on a distribution that moves, without any data of the target."""

from collections.abc import Generator
from dataclasses import replace
from typing import cast

from adr_service.distributions import Uniform, distribution_from_json
from adr_service.events import RunEvent
from adr_service.methods.base import CurriculumSettings
from adr_service.methods.catalogue import identity_of
from adr_service.programs.steps import evaluate_and_report, problem_of, training
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.target import open_target


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    space = problem_of(spec).source.space
    whole_box = Uniform(
        space, space.low, space.high
    )  # on which every curriculum's policy is judged
    known = identity_of(spec.method)
    stage = replace(
        training(spec, whole_box),
        curriculum=cast(CurriculumSettings, known["method"]),
        curriculum_package=known["method_package"],
    )
    trained = yield from stages.run(stage)
    assert trained.phases is not None, "a training with a curriculum has phases"
    last = distribution_from_json(space, trained.phases[-1].distribution)
    yield from evaluate_and_report(open_target(spec, stages), 0, [last], [trained])

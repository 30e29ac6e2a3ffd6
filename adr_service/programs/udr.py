"""Uniform domain randomisation: one policy for each of several random boxes, without any data."""

from collections.abc import Generator

from adr_service.distributions import Uniform
from adr_service.events import RunEvent
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.programs.steps import evaluate_and_report, problem_of, training
from adr_service.randomness import stream
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.target import open_target


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    boxes = boxes_of(spec, UdrSettings.model_validate(spec.method))
    trained = yield from stages.all([training(spec, box) for box in boxes])
    yield from evaluate_and_report(open_target(spec, stages), 0, boxes, trained)


def boxes_of(spec: RunSpec, settings: UdrSettings) -> list[Uniform]:
    """UDR's random bounds for a seed, the same in all variants with one source."""
    rng = stream("udr", spec.task, spec.training_domain, spec.seed)
    return random_bounds(problem_of(spec).source.space, settings, rng)

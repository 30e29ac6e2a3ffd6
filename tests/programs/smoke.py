"""Runs on the smoke preset, in this process."""

from adr_service.events import IterationFinished
from adr_service.programs import run
from adr_service.specs import RunSpec


def smoke(method, **changes):
    return RunSpec.model_validate({"task": "arm", "method": method, "preset": "smoke", **changes})


def iterations(spec, stages):
    return [event for event in run(spec, stages) if isinstance(event, IterationFinished)]


def executed(stages, kind):
    return [stage for stage in stages.executed if stage.kind == kind]

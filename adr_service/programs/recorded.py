"""Offline methods with a recorded target: one estimate and a policy.

There is nothing to visit or to evaluate on.
"""

from collections.abc import Generator

from adr_service.events import RunEvent
from adr_service.programs.offline import estimate_and_report
from adr_service.specs import RunSpec
from adr_service.stages.base import Stages
from adr_service.target import Recording


def run(spec: RunSpec, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    target = Recording(spec, recording)
    yield from estimate_and_report(spec, stages, target, 1, target.data)

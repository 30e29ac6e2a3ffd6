"""A stored run that nobody can compute: its package is not installed, or has other settings."""

from collections.abc import Generator

from adr_service.events import RunEvent
from adr_service.specs import LostRun
from adr_service.specs.lost import Lost
from adr_service.stages.base import Stages


def run(spec: LostRun, stages: Stages, recording: bytes | None) -> Generator[RunEvent, None, None]:
    yield from ()
    raise Lost(spec.reason)

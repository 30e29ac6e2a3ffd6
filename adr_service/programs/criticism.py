"""Criticism of a simulator: one stage, and its verdict."""

from collections.abc import Generator

from adr_service.errors import InvalidInput
from adr_service.events import CriticismFinished, RunEvent
from adr_service.json_values import sha256
from adr_service.specs import CriticismSpec
from adr_service.stages.base import Stages
from adr_service.stages.criticise import Criticise
from adr_service.tasks.catalogue import task_inputs


def run(
    spec: CriticismSpec, stages: Stages, recording: bytes | None
) -> Generator[RunEvent, None, None]:
    if recording is None:
        raise InvalidInput(f"the data {spec.dataset} were not given")
    where = task_inputs(spec.task)
    stage = Criticise(**where, variant=spec.variant, seed=spec.seed, data=recording)
    criticism = yield from stages.run(stage)
    files = {name: sha256(content) for name, content in criticism.files.items()}
    yield CriticismFinished(verdict=criticism.verdict, files=files)

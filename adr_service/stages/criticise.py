"""Criticise a task's simulator by a measurement."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from adr_service.criticism.nominal import Nominal
from adr_service.criticism.recordings import read_measurement
from adr_service.events import RunEvent
from adr_service.progress import Progress
from adr_service.stages.base import CoreSpeed, Cost, Result, Role, Stage
from adr_service.startup_time import preparing
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.transitions import dataset_id

_CRITICISM_S = 190.0  # on average over the robots of the planted cases, docs/criticism-measured.md


class Criticised(Result):
    """A verdict on a simulator, and the files that go with it."""

    verdict: dict[str, Any]  # JSON, `Verdict.to_json`
    verdict_file: bytes = Field(validation_alias="verdict.json", serialization_alias="verdict.json")
    report: bytes = Field(validation_alias="report.html", serialization_alias="report.html")
    extended: bytes | None = Field(
        default=None, validation_alias="extended.xml", serialization_alias="extended.xml"
    )
    effects: bytes | None = Field(
        default=None, validation_alias="effects.json", serialization_alias="effects.json"
    )

    @property
    def files(self) -> dict[str, bytes]:
        """The files by name."""
        return self.to_stored().blobs


@dataclass(frozen=True, kw_only=True)
class Criticise(Stage[Criticised]):
    """A whole criticism: sharing its parts between runs would not be worth it."""

    kind: ClassVar = "criticise"
    # raised whenever a verdict may change; CHANGELOG.md has what changed since version 11
    version: ClassVar = 25
    role: ClassVar[Role] = "inference"
    result: ClassVar = Criticised

    variant: str
    seed: int
    data: bytes  # a Measurement or a TransitionDataset as .npz

    def compute(self, rng: np.random.Generator, progress: Progress) -> Criticised:
        with preparing():  # matplotlib and SciPy
            from adr_service.criticism.pipeline import criticise
            from adr_service.criticism.report import files_of

        task = get_task(self.task)
        nominal = Nominal.of_task(task, source_of(self.task, self.variant))
        data = read_measurement(task, self.data)
        criticism = criticise(nominal, data, rng, progress, threads=1)  # a stage has one core
        # a result must not depend on the clock
        criticism = replace(criticism, verdict=replace(criticism.verdict, seconds=None))
        origin = f"{dataset_id(self.data)}, seed {self.seed}"  # no date, for the same reason
        files = files_of(criticism, f"{self.task}, {self.variant}", origin)
        return Criticised.model_validate({"verdict": criticism.verdict.to_json(), **files})

    def events(self, result: Criticised) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        return Cost(_CRITICISM_S)

    def stand_in(self) -> Criticised:
        return Criticised(verdict={}, verdict_file=self.digest.encode(), report=b"")

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
    # 2: many effects at once, 3: when they are, 4: named ones asked again, 5: misfit that persists,
    # strengths that are confused, an interval for what is explained, 6: errors after steps from
    # inferred velocities have a unit of their own, lines to change in one's MJCF, null for noise of
    # sensors that are not there, 7: errors over steps of measured columns alone, the report has
    # data, seed, versions and refined evidence, 8: units of free parameters, and changes of the
    # file without the attributes that MuJoCo's writer adds, 9: data without noise, ranges of
    # commands without those that nobody obeys, and unmeasured columns that hold a constant, 10: the
    # confidence of `unknown`, effects in positions that nobody measured, models that do not cut
    # commands or have an actuator without a gain, 11: bounds of drives' forces, least masses, and
    # what MuJoCo works out as it compiles a model, 12: quick predictions in finer steps where those
    # matter, late commands simulated and held before an episode, effects tried at sizes that fit
    # fast joints and long delays, strengths of one effect that do not absorb each other, detection
    # limits with the others known, and forces of servos, 13: deadband and fading of force commands
    # alone, a remark on effects that joints' limits rule out, and changes of unnamed elements, 14:
    # torque ripple, 15: a step chosen again once causes are in, and fits smoothed again where
    # their strengths have come far, 16: detection limits that do not hang on two episodes, 17:
    # friction that depends on the drive's load or on the joint's position, scales of encoders, 18:
    # a simulation that diverges within a control step is not taken for one that stands still,
    # effects in one sensor act one after the other, fits go on until their parameters have settled
    # and within their bounds, and causes whose strengths may all be zero are not named, 19: what a
    # link carries is judged by the robot's mass, and not by its own alone, 20: states are
    # smoothed until the data become no likelier, finer steps kept where they are likelier beyond
    # chance, softness of contacts and offsets of references tried at more sizes, and effects that
    # were too strong again at half, intervals of short recordings that hold less, detection
    # limits by the nearest size, two places of a group of three named apart, and effects that
    # forces ask for refined only where they predict better than none, 21: strengths that would
    # leave their bounds are held there, and steps end at bounds without another direction, fits
    # that simulate other transitions are not compared by likelihood, errors to expect of velocities
    # that nobody measured, and a flexible force chosen beside persisting misfit, 22: Student's
    # intervals of gains, so that two sealed episodes refute a cause as rarely as twenty, and
    # nothing refined beside a best candidate that stays hopeless, late positions behind by their
    # own velocities, 23: a backlash follows its joint's path between rows, 24: late velocities
    # behind by what they change in that time, and not on average since the row before, and
    # candidates refined that act where the best one does, however little they explain at first, 25:
    # each effect judged about states that are probable with it, an effect that includes another
    # takes its strength, and finer steps where they would move a strength
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

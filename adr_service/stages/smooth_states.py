"""Take the sensors' noise out of the states of a recording."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adr_service.criticism.smoothing import planned_steps, smooth
from adr_service.events import RunEvent
from adr_service.progress import Progress
from adr_service.stages.base import CoreSpeed, Cost, Result, Role, Stage
from adr_service.stages.stand_ins import trajectory
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.transitions import TransitionDataset


class SmoothedStates(Result):
    """A recording with smoothed states, and what was estimated on the way."""

    data: bytes  # an .npz of transitions
    parameters: list[float]  # (d,) SI
    sensor_std: list[float | None]  # positions', then velocities'; None: not measured
    simulated_steps: int  # control steps


@dataclass(frozen=True, kw_only=True)
class SmoothStates(Stage[SmoothedStates]):
    """The smoothing of one recording, for all methods that replay from smoothed states."""

    kind: ClassVar = "smooth_states"
    # 2: in data without noise, errors of the computation count as none, 3: fits take the steps
    # that they gain by, 4: parameters and strengths of an extension that would leave their bounds
    # are held there. What changes `criticism.fits`, `.linearisation` or `.probable_states` may ask
    # for another
    version: ClassVar = 4
    role: ClassVar[Role] = "inference"
    result: ClassVar = SmoothedStates

    variant: str  # a domain; the field's name is part of the digest
    seed: int
    data: bytes  # an .npz of transitions

    def compute(self, rng: np.random.Generator, progress: Progress) -> SmoothedStates:
        task, source = get_task(self.task), source_of(self.task, self.variant)
        smoothing = smooth(task, source, TransitionDataset.from_npz(self.data), progress)
        deviations = smoothing.sensor_std.tolist()
        return SmoothedStates(
            data=smoothing.data.to_npz(),
            parameters=smoothing.parameters.tolist(),
            sensor_std=[None if np.isnan(each) else each for each in deviations],
            simulated_steps=smoothing.simulated_steps,
        )

    def events(self, result: SmoothedStates) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        parameters = len(source_of(self.task, self.variant).space)
        transitions = len(TransitionDataset.from_npz(self.data))
        steps = planned_steps(get_task(self.task), parameters, transitions)
        return Cost(steps / speed.steps_per_second(self.task))

    def stand_in(self) -> SmoothedStates:
        count = len(TransitionDataset.from_npz(self.data))
        data = trajectory(self.task, count, self.digest)
        return SmoothedStates(data=data, parameters=[], sensor_std=[], simulated_steps=0)

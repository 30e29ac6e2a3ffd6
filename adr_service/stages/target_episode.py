"""One episode on an external target, which a robot's client claims as a task and uploads."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.errors import InvalidInput
from adr_service.events import MOST_RETURN, RunEvent
from adr_service.npz import read_arrays
from adr_service.progress import Progress
from adr_service.simulation.batch import control_period
from adr_service.simulation.replay import check_recorded, gap_of
from adr_service.stages.base import CoreSpeed, Cost, Result, Role, Stage
from adr_service.stages.stand_ins import trajectory
from adr_service.tasks.catalogue import get_task
from adr_service.transitions import MOST_COLUMNS, TransitionDataset


class RobotEpisode(Result):
    """One episode of a robot: its trajectory, and its return."""

    transitions: int
    earned: float = Field(validation_alias="return", serialization_alias="return")  # undiscounted
    data: bytes  # a TransitionDataset as .npz


@dataclass(frozen=True, kw_only=True)
class TargetEpisode(Stage[RobotEpisode]):
    """An episode for a robot. It belongs to one run: robots do not repeat themselves."""

    kind: ClassVar = "target_episode"
    version: ClassVar = 1
    role: ClassVar[Role] = "robot"
    result: ClassVar = RobotEpisode

    run: str
    purpose: Literal["rollout", "return", "evaluation"]  # a rollout may be shorter than asked for
    number: int
    transitions: int
    seed: int
    policy: bytes | None = None  # None: random actions

    def compute(self, rng: np.random.Generator, progress: Progress) -> RobotEpisode:
        raise InvalidInput(
            "an external target needs the service: the robot's client gets its tasks from there"
        )

    def events(self, result: RobotEpisode) -> list[RunEvent]:
        return []

    def cost(self, speed: CoreSpeed) -> Cost:
        metered = 0 if self.purpose == "evaluation" else self.transitions
        period = control_period(get_task(self.task))
        return Cost(self.transitions * period, target_transitions=metered)

    def stand_in(self) -> RobotEpisode:
        data = trajectory(self.task, self.transitions, self.digest)
        return RobotEpisode(transitions=self.transitions, earned=0.0, data=data)


def read_episode(task_name: str, transitions: int, content: bytes) -> RobotEpisode:
    """The result that a robot uploaded for an episode of at most `transitions`.

    `content` is the `.npz` of a TransitionDataset with `rewards` (N,). Raises InvalidInput where
    it is not of the task, is not one episode of rows that follow one another, or is longer than was
    asked for.
    """
    longest = max(transitions, MOST_COLUMNS)  # a name for each column takes rows too
    fields = read_arrays(content, (*TransitionDataset.ARRAYS, "rewards"), longest)
    rewards = fields.pop("rewards", None)
    data = TransitionDataset.from_arrays(fields)
    check_recorded(get_task(task_name), data)
    if (gap := gap_of(data)) is not None:
        raise InvalidInput(f"the rows do not follow one another: {gap}; send them in time's order")
    if data.episode_count != 1:
        raise InvalidInput(f"a task is one episode; the data have {data.episode_count}")
    if len(data) > transitions:
        raise InvalidInput(
            f"the task asks for {transitions} transitions at most; given {len(data)}"
        )
    earned = _return_of(rewards, len(data))
    return RobotEpisode(transitions=len(data), earned=earned, data=data.to_npz())


def _return_of(rewards: np.ndarray | None, steps: int) -> float:
    """The sum of the rewards (N,) of an episode of N steps."""
    if rewards is None or rewards.dtype.kind not in "iuf" or rewards.shape != (steps,):
        given = "nothing" if rewards is None else f"{rewards.dtype} {rewards.shape}"
        raise InvalidInput(f"rewards must be ({steps},) numbers; given {given}")
    with np.errstate(over="ignore", invalid="ignore"):  # the sum is refused below
        earned = float(np.sum(rewards, dtype=np.float64))
    if not abs(earned) <= MOST_RETURN:  # nor is a sum that is no number
        raise InvalidInput(f"rewards must be finite, and their sum at most {MOST_RETURN:g}")
    return earned

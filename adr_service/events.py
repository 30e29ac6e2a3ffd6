"""What happens in a run, as values with a deterministic key: written once, replayed freely.

Science events (`stage_finished`, `training_evaluated`, `iteration_finished`) come from the
program and repeat when it runs again, so their key is what they speak of. Lifecycle events carry
the number of times the run was (re)submitted. A run's state is the fold of its events.
"""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from adr_service.json_values import Wire

RunState = Literal["queued", "running", "succeeded", "failed", "cancelled"]
FINISHED: frozenset[RunState] = frozenset({"succeeded", "failed", "cancelled"})


class StageFinished(Wire):
    """A stage has a result, computed for this run or for another."""

    type: Literal["stage_finished"] = "stage_finished"
    kind: str
    digest: str

    @property
    def key(self) -> str:
        return f"stage_finished:{self.digest}"


class TrainingEvaluated(Wire):
    """A point of a policy's learning curve: its return on the source after so many steps."""

    type: Literal["training_evaluated"] = "training_evaluated"
    digest: str = Field(description="of the training's stage")
    steps: int  # of the environments
    mean_return: float
    standard_error: float  # over the evaluation episodes

    @property
    def key(self) -> str:
        return f"training_evaluated:{self.digest}:{self.steps}"


class IterationFinished(Wire):
    """The method's answer after `iteration` rounds of target data, evaluated on the target.

    `returns` holds one list of undiscounted episode returns per policy (several for UDR); it is
    empty where there is no target to evaluate on.
    """

    type: Literal["iteration_finished"] = "iteration_finished"
    iteration: int
    target_rollouts: int
    target_transitions: int  # metered, what the method could learn from
    evaluation_episodes: int  # metered apart, seen by no method
    distributions: list[dict[str, Any]]
    policies: list[str]  # SHA-256 of the policy bytes
    source_returns: list[float]  # best evaluation of each training, so a little high
    reached_threshold: list[bool]
    training_steps: list[int]
    inference_steps: int  # simulated control steps of the inference
    inferences: list[str] = Field([], description="digests of the stages")
    returns: list[list[float]]
    diverged_episodes: int = 0  # of those, simulations that stopped being finite
    diagnostics: dict[str, Any]

    @property
    def key(self) -> str:
        return f"iteration_finished:{self.iteration}"


class CriticismFinished(Wire):
    """The verdict on a simulator, and the files that go with it."""

    type: Literal["criticism_finished"] = "criticism_finished"
    verdict: dict[str, Any]
    files: dict[str, str] = Field(description="SHA-256 by name")

    @property
    def key(self) -> str:
        return "criticism_finished"


class RunQueued(Wire):
    type: Literal["run_queued"] = "run_queued"
    submission: int

    @property
    def key(self) -> str:
        return f"run_queued:{self.submission}"


class RunStarted(Wire):
    type: Literal["run_started"] = "run_started"
    submission: int

    @property
    def key(self) -> str:
        return f"run_started:{self.submission}"


class RunSucceeded(Wire):
    type: Literal["run_succeeded"] = "run_succeeded"

    @property
    def key(self) -> str:
        return "run_succeeded"


class RunFailed(Wire):
    """`code` is what machines read, `message` what people do."""

    type: Literal["run_failed"] = "run_failed"
    submission: int
    code: str
    message: str

    @property
    def key(self) -> str:
        return f"run_failed:{self.submission}"


class RunStopped(Wire):
    type: Literal["run_stopped"] = "run_stopped"
    submission: int

    @property
    def key(self) -> str:
        return f"run_stopped:{self.submission}"


RunEvent = Annotated[
    StageFinished
    | TrainingEvaluated
    | IterationFinished
    | CriticismFinished
    | RunQueued
    | RunStarted
    | RunSucceeded
    | RunFailed
    | RunStopped,
    Field(discriminator="type"),
]
_ADAPTER: TypeAdapter[RunEvent] = TypeAdapter(RunEvent)


def event_from_json(text: str) -> RunEvent:
    return _ADAPTER.validate_json(text)


def state_after(events: Iterable[RunEvent]) -> RunState:
    """The state of a run with these events, in order."""
    state: RunState = "queued"
    for event in events:
        state = next_state(state, event)
    return state


def next_state(state: RunState, event: RunEvent) -> RunState:
    match event:
        case RunQueued():
            return "queued"
        case RunStarted():
            return "running"
        case RunSucceeded():
            return "succeeded"
        case RunFailed():
            return "failed"
        case RunStopped():
            return "cancelled"
        case _:
            return state

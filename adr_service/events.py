"""Events of a run: values with a deterministic key, written once and replayed freely.

Science events (`stage_finished`, `training_evaluated`, `iteration_finished`) come from the
program and repeat when it runs again, so their key is what they speak of. Lifecycle events carry
the number of times the run was (re)submitted. A run's state is the fold of its events.
"""

from collections.abc import Iterable
from enum import StrEnum
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from adr_service.json_values import Wire

MOST_RETURN = 1e12  # bound on an episode's return, of either sign


class RunState(StrEnum):
    """State of a run: the fold of its events."""

    QUEUED = "queued"  # it waits for its first stage, or for the service to go on with it
    RUNNING = "running"  # its program asks for stages
    SUCCEEDED = "succeeded"  # its program ran to its end
    FAILED = "failed"  # an error ended it; it can be resumed
    CANCELLED = "cancelled"  # a user stopped it; it can be resumed

    @property
    def is_finished(self) -> bool:
        """True if nothing more happens to the run unless a user resumes it."""
        return self in FINISHED

    @property
    def is_resumable(self) -> bool:
        """True if a user can queue the run again."""
        return self in RESUMABLE


RESUMABLE = frozenset({RunState.FAILED, RunState.CANCELLED})
FINISHED = RESUMABLE | {RunState.SUCCEEDED}


class StageFinished(Wire):
    """A stage has a result, computed for this run or for another."""

    type: Literal["stage_finished"] = "stage_finished"
    kind: str
    digest: str

    @property
    def key(self) -> str:
        return f"{self.type}:{self.digest}"


class TrainingEvaluated(Wire):
    """A point of a policy's learning curve: its return on the source after `steps` steps."""

    type: Literal["training_evaluated"] = "training_evaluated"
    digest: str = Field(description="of the training's stage")
    steps: int  # of the environments
    mean_return: float
    standard_error: float  # over the evaluation episodes

    @property
    def key(self) -> str:
        return f"{self.type}:{self.digest}:{self.steps}"


# Undiscounted; the bound keeps means and spreads of what strangers send finite.
BoundedReturn = Annotated[float, Field(ge=-MOST_RETURN, le=MOST_RETURN)]


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
    source_returns: list[float]  # of each training: its confirmation, else its best evaluation
    reached_threshold: list[bool]
    training_steps: list[int]
    inference_steps: int  # simulated control steps of the inference
    inferences: list[str] = Field([], description="digests of the stages")
    returns: list[Annotated[list[BoundedReturn], Field(min_length=1)]]
    diverged_episodes: int = 0  # of those, simulations that stopped being finite
    diagnostics: dict[str, Any]

    @property
    def key(self) -> str:
        return f"{self.type}:{self.iteration}"


class CriticismFinished(Wire):
    """The verdict on a simulator, and the files that go with it."""

    type: Literal["criticism_finished"] = "criticism_finished"
    verdict: dict[str, Any]
    files: dict[str, str] = Field(description="SHA-256 by name")

    @property
    def key(self) -> str:
        return self.type


class RunQueued(Wire):
    """A user submitted the run, or resumed it."""

    type: Literal["run_queued"] = "run_queued"
    submission: int

    @property
    def key(self) -> str:
        return f"{self.type}:{self.submission}"


class RunStarted(Wire):
    """The service began to iterate the run's program."""

    type: Literal["run_started"] = "run_started"
    submission: int

    @property
    def key(self) -> str:
        return f"{self.type}:{self.submission}"


class RunSucceeded(Wire):
    """The run's program came to its end."""

    type: Literal["run_succeeded"] = "run_succeeded"

    @property
    def key(self) -> str:
        return self.type


class RunFailed(Wire):
    """An error ended the run: `code` for machines (see `FailureCode`), `message` for people."""

    type: Literal["run_failed"] = "run_failed"
    submission: int
    code: str
    message: str

    @property
    def key(self) -> str:
        return f"{self.type}:{self.submission}"


class RunStopped(Wire):
    """A user's request to cancel ended the run."""

    type: Literal["run_stopped"] = "run_stopped"
    submission: int

    @property
    def key(self) -> str:
        return f"{self.type}:{self.submission}"


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


def type_of(kind: type[Wire]) -> str:
    """The type of a kind of event, with which its keys begin."""
    return str(kind.model_fields["type"].default)


def event_from_json(text: str) -> RunEvent:
    """Parse an event as `model_dump_json` writes it."""
    return _ADAPTER.validate_json(text)


def state_after(events: Iterable[RunEvent]) -> RunState:
    """The state of a run with these events, in order."""
    state = RunState.QUEUED
    for event in events:
        state = next_state(state, event)
    return state


def next_state(state: RunState, event: RunEvent) -> RunState:
    """The state of a run in `state` after one more event; science events leave it."""
    match event:
        case RunQueued():
            return RunState.QUEUED
        case RunStarted():
            return RunState.RUNNING
        case RunSucceeded():
            return RunState.SUCCEEDED
        case RunFailed():
            return RunState.FAILED
        case RunStopped():
            return RunState.CANCELLED
        case _:
            return state

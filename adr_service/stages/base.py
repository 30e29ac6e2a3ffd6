"""The unit of work: a pure function of digestible inputs, and who runs it.

    stage = Evaluate(task="arm", variant="vanilla", episodes=10, seed=0, policy=policy)
    evaluation = yield from stages.run(stage)

A stage is an immutable value: its kind, the kind's version and its inputs. Their SHA-256 is its
digest, and its random stream comes from the digest. So equal stages are computed once, by
whoever asks first, and asking again is free: that is how runs share work and how they resume.

A kind of stage is one class in one file of this package: its fields are its inputs, and its
methods compute the result, say what that costs, and give a stand-in result to plan with.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Annotated, Any, ClassVar, Generic, Literal, Protocol, TypeVar, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, PlainSerializer, PlainValidator, ValidationInfo
from threadpoolctl import threadpool_limits

from adr_service.distributions import Distribution, distribution_from_json
from adr_service.errors import InvalidInput
from adr_service.events import RunEvent, StageFinished
from adr_service.json_values import canonical_json, sha256
from adr_service.parameters import ParameterSpace
from adr_service.plugins import other_versions
from adr_service.progress import Progress, checked, silent
from adr_service.randomness import stream

Role = Literal["trainer", "inference", "target", "robot"]  # of the process that computes it
# light stages first: they are short, and trainings wait for them
PRIORITY: Mapping[Role, int] = {"target": 0, "inference": 1, "trainer": 2}


@dataclass(frozen=True)
class StageResult:
    """A result as it is stored: JSON values and named bytes."""

    values: dict[str, Any]
    blobs: dict[str, bytes] = field(default_factory=dict[str, bytes])


@dataclass(frozen=True)
class Cost:
    """Expected cost of computing a stage once."""

    seconds: float  # on one core; of a robot's episode, on the robot
    environment_steps: int = 0  # of a training, at most
    target_transitions: int = 0  # that the target is metered for, at most
    policy_bytes: int = 0


class CoreSpeed(Protocol):
    """The speed of one core, by which stages estimate their cost."""

    def steps_per_second(self, task: str) -> float:
        """Control steps of a task's simulator per second."""
        ...


def _decode(given: Any, info: ValidationInfo) -> Distribution:
    if isinstance(given, Mapping):
        space: ParameterSpace = cast(Any, info.context).space
        return distribution_from_json(space, dict(cast(Mapping[str, Any], given)))
    return given


# JSON in stored results; a stage whose result has one has a property `space` to read it with
Belief = Annotated[
    Distribution, PlainValidator(_decode), PlainSerializer(lambda belief: belief.to_json())
]


class Result(BaseModel):
    """Base of the results of stages. Fields of bytes are stored as blobs, all others as JSON."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True
    )

    def to_stored(self) -> StageResult:
        """The form in which the result is stored; optional fields without a value are left out."""
        return StageResult(*_split(self.model_dump(by_alias=True)))


R = TypeVar("R", bound=Result)


@dataclass(frozen=True, kw_only=True)
class Stage(ABC, Generic[R]):
    """Base of the kinds of stages. Fields of bytes are binary inputs, all others are JSON."""

    kind: ClassVar[str]
    version: ClassVar[int]  # bumped when results of the kind change
    role: ClassVar[Role]
    result: ClassVar[type[Result]]

    task: str
    package: str | None = None  # name and version of the package that adds the task

    @abstractmethod
    def compute(self, rng: np.random.Generator, progress: Progress) -> R:
        """The result. All random numbers come from `rng`."""
        ...

    @abstractmethod
    def events(self, result: R) -> list[RunEvent]:
        """Events besides `stage_finished` that a result puts on the record of a run."""
        ...

    @abstractmethod
    def cost(self, speed: CoreSpeed) -> Cost:
        """The expected cost; where a stage may stop early, as if it did not."""
        ...

    @abstractmethod
    def stand_in(self) -> R:
        """A result of the right form for a plan: cheap, and different for different digests."""
        ...

    @cached_property
    def digest(self) -> str:
        return sha256(canonical_json(self.document).encode())

    @property
    def inputs(self) -> dict[str, Any]:
        """The inputs that are JSON; optional ones without a value are left out."""
        return self._split[0]

    @property
    def blobs(self) -> dict[str, bytes]:
        """The binary inputs."""
        return self._split[1]

    @property
    def document(self) -> dict[str, Any]:
        """The content of the digest: kind, version, inputs, and hashes of the binary inputs."""
        inputs, blobs = self._split
        return {
            "kind": self.kind,
            "version": self.version,
            "inputs": inputs,
            "blobs": {name: sha256(content) for name, content in blobs.items()},
        }

    def read(self, stored: StageResult) -> R:
        """The result that was stored."""
        values = {**stored.values, **stored.blobs}
        return cast(R, self.result.model_validate(values, context=self))

    @property
    def _split(self) -> tuple[dict[str, Any], dict[str, bytes]]:
        return _split({field.name: _as_json(getattr(self, field.name)) for field in fields(self)})


AnyStage = Stage[Any]


def compute(stage: AnyStage, progress: Progress = silent) -> StageResult:
    """Run a stage here and now; its random numbers come from its digest.

    On one thread, because the last bits of a BLAS product depend on how many share it. Raises
    InvalidInput if this process has another version of a package, or of this program, than the
    stage is of: the result would be stored under the wrong one. Also if a value of the result is
    not JSON, as a plug-in's diagnostics may be.
    """
    if sha256(canonical_json(stage.document).encode()) != stage.digest:  # which came with it
        raise InvalidInput(
            f"this process computes version {stage.version} of {stage.kind}, and was asked for "
            "another: install one version of the service everywhere, and start it again"
        )
    for other in other_versions(stage.inputs).values():
        raise InvalidInput(
            f"this process has {other.here}, the stage is of {other.of_stage}: install one version "
            "everywhere, and start the service again"
        )
    with threadpool_limits(1):
        result = stage.compute(stream("stage", stage.digest), checked(progress)).to_stored()
    for name, value in result.values.items():
        _check_json(f"{name} of {stage.kind}", value)
    return result


def events_of(stage: Stage[R], result: R) -> list[RunEvent]:
    """The events that a finished stage puts on the record of every run that asked for it."""
    finished = StageFinished(kind=stage.kind, digest=stage.digest)
    return [*stage.events(result), finished]


class Stages(Protocol):
    """Runner of stages. Both functions yield the events of what happens meanwhile."""

    run_id: str  # of the run that asks; a robot's episodes belong to one run alone

    def all(self, stages: Sequence[Stage[R]]) -> Generator[RunEvent, None, list[R]]:
        """The results of `stages`, in their order; they may run at the same time.

        Raises RunCancelled where the run shall stop, and StageFailed where a stage fails on Ray.
        Without Ray, what the stage itself raised comes through.
        """
        ...

    def run(self, stage: Stage[R]) -> Generator[RunEvent, None, R]:
        """The result of one stage."""
        ...


def _split(fields: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The JSON values and the bytes among fields; those without a value are in neither."""
    given = {name: content for name, content in fields.items() if content is not None}
    blobs = {name: content for name, content in given.items() if isinstance(content, bytes)}
    return {name: content for name, content in given.items() if name not in blobs}, blobs


def _check_json(name: str, value: Any) -> None:
    """Raise InvalidInput unless the value is JSON; `name` says which it is."""
    match value:
        case dict():
            for key, each in cast(dict[Any, Any], value).items():
                if not isinstance(key, str):
                    raise InvalidInput(f"a key in {name} must be text; given {key!r}")
                _check_json(f"{key} in {name}", each)
        case list() | tuple():
            for each in cast(Sequence[Any], value):
                _check_json(f"an item of {name}", each)
        case float() if not math.isfinite(value):
            raise InvalidInput(f"{name} is {value}, which is not a JSON number")
        case None | str() | int() | float():
            pass
        case _:
            raise InvalidInput(
                f"{name} is of type {type(value).__name__}, which is not JSON; accepted are "
                "numbers, text, booleans, None, and lists and dictionaries of them"
            )


def _as_json(value: Any) -> Any:
    """An input as JSON; bytes and JSON as they are."""
    if hasattr(value, "to_json"):
        return value.to_json()
    if isinstance(value, BaseModel):
        return value.model_dump()
    if isinstance(value, list):
        return [_as_json(each) for each in cast(list[Any], value)]
    return value

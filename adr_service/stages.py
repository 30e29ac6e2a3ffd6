"""The unit of work: a pure function of digestible inputs, and who runs it.

    inputs = {"task": "arm", "variant": "vanilla", "episodes": 10, "seed": 0}
    stage = Stage("evaluate", inputs, {"policy": policy_bytes})
    result = yield from stages.run(stage)

A stage is its kind, the kind's version, JSON inputs and binary inputs; their SHA-256 is its
digest, and its random stream comes from the digest. So equal stages are computed once, by
whoever asks first, and asking again is free: that is how runs share work and how they resume.
"""

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol

from adr_service.events import RunEvent, StageFinished, TrainingEvaluated
from adr_service.json_values import canonical_json, sha256

Role = Literal["trainer", "inference", "target", "robot"]


@dataclass(frozen=True)
class StageKind:
    """The version is bumped when results of the kind change; the role says who computes it."""

    version: int
    role: Role


KINDS = {
    "train_policy": StageKind(version=3, role="trainer"),
    "infer": StageKind(version=2, role="inference"),
    "target_rollout": StageKind(version=2, role="target"),
    "target_return": StageKind(version=1, role="target"),
    "propose": StageKind(version=1, role="inference"),
    "evaluate": StageKind(version=2, role="target"),
    "target_episode": StageKind(version=1, role="robot"),
    "criticise": StageKind(version=1, role="inference"),
}


@dataclass(frozen=True)
class StageResult:
    """What a stage computed: JSON values and named bytes."""

    values: dict[str, Any]
    blobs: dict[str, bytes] = field(default_factory=dict[str, bytes])


@dataclass(frozen=True)
class Stage:
    """A piece of work, by everything that its result depends on."""

    kind: str
    inputs: dict[str, Any]  # JSON
    blobs: dict[str, bytes] = field(default_factory=dict[str, bytes])

    @cached_property
    def digest(self) -> str:
        return sha256(canonical_json(self.document).encode())

    @property
    def document(self) -> dict[str, Any]:
        """What is digested: kind, version, inputs, and the hashes of the binary inputs."""
        return {
            "kind": self.kind,
            "version": KINDS[self.kind].version,
            "inputs": self.inputs,
            "blobs": {name: sha256(content) for name, content in self.blobs.items()},
        }


def learning_curve(digest: str, values: Mapping[str, Any]) -> list[RunEvent]:
    """The learning curve that a training's values hold, finished or not."""
    return [TrainingEvaluated(digest=digest, **point) for point in values.get("curve", [])]


def events_of(stage: Stage, result: StageResult) -> list[RunEvent]:
    """What a finished stage puts on the record of every run that asked for it."""
    finished = StageFinished(kind=stage.kind, digest=stage.digest)
    return [*learning_curve(stage.digest, result.values), finished]


class Stages(Protocol):
    """Who runs stages. Both functions yield the events of what happens meanwhile."""

    run_id: str  # who asks; a robot's episodes are of one run alone

    def all(self, stages: Sequence[Stage]) -> Generator[RunEvent, None, list[StageResult]]:
        """The results of `stages`, in their order; they may run at the same time.

        Raises StageFailed where one has no result, RunCancelled where the run was asked to stop.
        """
        ...

    def run(self, stage: Stage) -> Generator[RunEvent, None, StageResult]:
        """The result of one stage."""
        ...

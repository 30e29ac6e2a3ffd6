"""Specs of single runs: a method on a task, or a criticism."""

from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema

from adr_service.criticism.smoothing import check_smoothable
from adr_service.effects.base import Effect, domain_of
from adr_service.errors import AdrError
from adr_service.json_values import Wire
from adr_service.methods.catalogue import AnyMethod, names_of
from adr_service.methods.simopt import SimOptSettings
from adr_service.simulation.batch import check_effects
from adr_service.specs.filling import filled_from_preset
from adr_service.specs.names import (
    Collector,
    Name,
    PresetName,
    Resolution,
    Seed,
    TaskName,
    VariantName,
    known_method,
)
from adr_service.specs.target import AnyTarget, RecordedTarget, SimulatedTarget
from adr_service.tasks.catalogue import first_like, get_task, variant_of
from adr_service.training.settings import TrainingSettings


class RunSpec(Wire):
    """One method on one task variant with one seed."""

    kind: Literal["transfer"] = "transfer"
    task: TaskName
    variant: VariantName = Field("vanilla", validate_default=True)
    method: Annotated[AnyMethod, BeforeValidator(known_method)] = Field(
        description="a method's name, or its settings with `name`"
    )
    target: AnyTarget = Field(
        SimulatedTarget(), description="where the trajectories of the target come from"
    )
    extension: list[Effect] = Field(
        default=[],
        max_length=100,
        description="effects that the source is extended by, as `adr criticise` writes them",
    )
    collector: Literal[Collector, "recording"] = Field(
        "simopt",
        description="whose actions offline methods see: SimOpt's policies' (the protocol), the "
        "prior's policy's, random ones in one episode or in several (random_matched) until "
        "`transitions` are recorded (the data-collection study), or those of a recorded target",
    )
    simopt: SimOptSettings | None = Field(
        None, description="whose trajectories an offline method learns from; default: the preset's"
    )
    seed: Seed = 0
    preset: PresetName = "quick"
    iterations: int = Field(ge=1, le=100, description="target rollouts a method may use")
    transitions: int = Field(ge=1, le=100_000, description="per target rollout, at most")
    evaluation_episodes: int = Field(ge=2, le=10_000, description="final, seen by no method")
    training: TrainingSettings = Field(description="how every policy is trained")
    resolution: Resolution | None = Field(
        None,
        description="beliefs that are narrower than this in [0, 4] are trained as points on a grid "
        "of this width, so that equal answers share a policy; null: every belief as it is",
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, given: Any) -> Any:
        return filled_from_preset(given) if isinstance(given, dict) else given

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """The schema of a request, in which the preset fills fields that are not given."""
        reference = handler(core_schema)
        schema = handler.resolve_ref_schema(reference)
        if handler.mode == "validation":
            fields = schema["properties"]
            training = handler.resolve_ref_schema(fields["training"])
            fields["training"] = {k: v for k, v in training.items() if k != "required"}
            for name in ("method", "simopt"):
                fields[name] = {"anyOf": [{"type": "string", "maxLength": 1000}, fields[name]]}
            schema["required"] = ["task", "method"]
        return reference

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        self._check_task()
        self._check_target()
        self._check_collector()
        return self

    def _check_task(self) -> None:
        """Refuse effects that the task's simulator cannot have, methods that cannot infer its
        parameters, and rollouts beyond its horizon."""
        pair, task = variant_of(self.task, self.variant), get_task(self.task)
        for name, source, effects in (
            ("extension", pair.source, self.extension),
            ("target.effects", pair.hidden.source, self.hidden_effects),
        ):
            try:
                check_effects(task, replace(source, effects=tuple(effects)))
            except AdrError as error:
                raise ValueError(f"{name}: {error}") from error
        for name, settings in (("method", self.method), ("simopt", self.simopt)):
            try:
                if settings is not None:
                    settings.check_parameters(len(pair.source.space))
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
        if self.method.replay_from == "smoothed":
            if self.method.learns_from != "recordings":
                raise ValueError(
                    f"method: {self.method.name} replays from smoothed states, which methods that "
                    "learn from recordings can do alone"
                )
            try:
                check_smoothable(task)
            except AdrError as error:
                raise ValueError(
                    f"method: {self.method.name} cannot smooth the states of {self.task}: {error}; "
                    "the method without `_smoothed` can be run"
                ) from error
        uses_rollouts = self.method.infers and not isinstance(self.target, RecordedTarget)
        if uses_rollouts and self.transitions > task.horizon:
            raise ValueError(
                f"transitions: {self.transitions} given, or by the preset {self.preset!r}, but an "
                f"episode of {self.task} has {task.horizon} steps at most: give that many or fewer"
            )

    def _check_target(self) -> None:
        """Refuse a target of which the method cannot learn what it needs."""
        is_recorded = isinstance(self.target, RecordedTarget)
        if not is_recorded and self.transitions < self.method.least_transitions:
            raise ValueError(
                f"transitions: {self.transitions} given, and {self.method.name} with steps = "
                f"{self.method.least_transitions} learns from no fewer"
            )
        if is_recorded and self.method.learns_from != "recordings":
            raise ValueError(
                f"method: {self.method.name} needs a target that it can visit; a recorded one "
                f"serves {', '.join(names_of('recordings'))}"
            )
        if self.method.needs_truth and not isinstance(self.target, SimulatedTarget):
            raise ValueError(
                f"method: nobody knows the truth that the {self.method.name} would be trained on"
            )
        if (self.collector == "recording") != is_recorded:
            raise ValueError(
                f"collector: {self.collector!r} given, with a {self.target.kind} target; "
                "'recording' goes with a recorded one, and nothing else does"
            )

    def _check_collector(self) -> None:
        """Refuse a collector, or a SimOpt that collects, for a method that needs none."""
        is_offline = self.method.learns_from == "recordings"
        if self.collector != "simopt" and not is_offline:
            raise ValueError(
                f"collector: {self.collector!r} given, but only "
                f"{', '.join(names_of('recordings'))} learn from what another policy collects"
            )
        if (self.simopt is not None) != (is_offline and self.collector == "simopt"):
            raise ValueError(
                "simopt: given, but this run learns nothing from SimOpt's trajectories"
            )

    @property
    def program(self) -> str:
        """The module of the program that runs it."""
        return self.target.program or self.method.program

    @property
    def source_domain(self) -> str:
        """The domain that methods may simulate."""
        return domain_of(self.variant, self.extension)

    @property
    def training_domain(self) -> str:
        """The source's domain under one name for all variants that have it."""
        return domain_of(first_like(self.task, self.variant), self.extension)

    @property
    def target_domain(self) -> str:
        """The domain that policies are judged on."""
        return domain_of(self.variant, self.hidden_effects)

    @property
    def hidden_effects(self) -> list[Effect]:
        """Effects that the simulated target has and its file lacks."""
        return self.target.effects if isinstance(self.target, SimulatedTarget) else []

    @property
    def dataset(self) -> str | None:
        """The id of the stored recording that it learns from."""
        return self.target.dataset if isinstance(self.target, RecordedTarget) else None

    @property
    def label(self) -> str:
        """The method, for lists of runs."""
        return self.method.name

    @property
    def column(self) -> str:
        """The method, and who collects for it where that is not as in the protocol."""
        return self.method.name + ("" if self.collector == "simopt" else f" on {self.collector}")

    @property
    def suffix(self) -> str:
        """The end of a title: an extended simulator or an unusual target, or nothing."""
        told = ""
        if self.extension:
            told += ", extended by " + ", ".join(
                f"{e.kind} at {e.location}" for e in self.extension
            )
        if self.target.kind != "simulated":
            told += f", {self.target.kind} target"
        elif self.target.effects:
            told += ", on a target with effects of its own"
        return told


class CriticismSpec(Wire):
    """Criticism of a task's simulator by what its robot did."""

    kind: Literal["criticism"] = "criticism"
    program: ClassVar[str] = "adr_service.programs.criticism"
    task: TaskName
    variant: VariantName = Field("vanilla", validate_default=True)
    dataset: Name = Field(description="id of an uploaded measurement or recording")
    seed: Seed = Field(0, description="of the bootstraps")

    @property
    def label(self) -> str:
        """The kind of run, for lists of runs."""
        return self.kind


AnyRun = Annotated[RunSpec | CriticismSpec, Field(discriminator="kind")]

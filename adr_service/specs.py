"""What to run: the request body, the database row and the program's only argument.

    spec = RunSpec.model_validate({"task": "arm", "method": "simopt", "preset": "smoke"})

A run's spec is complete: validation fills what was not given from the preset, so that a stored
one means the same when presets change. What is given wins over the preset, field by field.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, cast

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    Tag,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import CoreSchema

from adr_service.causes import Cause, domain_of
from adr_service.errors import AdrError, InvalidInput, UnknownName
from adr_service.json_values import Wire, explain
from adr_service.methods.catalogue import AnyMethod, methods, names_of
from adr_service.methods.simopt import SimOptSettings
from adr_service.presets import PRESETS
from adr_service.simulation.batch import check_effects
from adr_service.tasks.catalogue import catalogue, get_task, variant_of
from adr_service.training.settings import TrainingSettings

MAX_RUNS = 5000  # of one benchmark
Collector = Literal["simopt", "prior", "random"]


def _known(kind: str, name: str, accepted: Any) -> str:
    if name not in accepted:
        raise ValueError(str(UnknownName(kind, name, accepted)))
    return name


def _known_variant(name: str, info: ValidationInfo) -> str:
    """A variant of the task, or of all; where those are wrong, their own errors say enough."""
    for task in info.data.get("tasks", [info.data["task"]] if "task" in info.data else []):
        try:
            variant_of(task, name)
        except UnknownName as error:
            raise ValueError(str(error)) from error
    return name


def _known_method(given: Any) -> Any:
    """Pydantic refuses unknown names too, but does not say which was meant."""
    if isinstance(given, Wire):
        return given
    name = cast(dict[str, Any], given).get("name") if isinstance(given, dict) else given
    if not isinstance(name, str):
        raise ValueError(
            f"give a method's name, or its settings with `name`; accepted: {', '.join(methods())}"
        )
    _known("method", name, methods())
    return given


# pydantic refuses half characters (lone surrogates) where a text has a length
Name = Annotated[str, Field(max_length=1000)]
TaskName = Annotated[Name, AfterValidator(lambda name: _known("task", name, catalogue()))]
VariantName = Annotated[Name, AfterValidator(_known_variant)]
PresetName = Annotated[Name, AfterValidator(lambda name: _known("preset", name, PRESETS))]
Seed = Annotated[int, Field(ge=0, lt=2**31)]
NameOrSettings = Annotated[
    Annotated[Name, Tag("name")] | Annotated[AnyMethod, Tag("settings")],
    Discriminator(lambda given: "name" if isinstance(given, str) else "settings"),
    BeforeValidator(_known_method),
    # no name is settings too, which fuzzers cannot see behind "oneOf"
    Field(json_schema_extra=lambda schema: schema.update(anyOf=schema.pop("oneOf"))),
]


class Effect(Wire):
    """An effect that a simulator's file lacks, as criticism names it."""

    kind: Name
    location: Name = Field(description="as joint:elbow, or global")
    values: list[float] = Field(
        min_length=1, max_length=100, description="strengths in the mechanism's order"
    )

    @property
    def cause(self) -> Cause:
        return Cause(self.kind, self.location, tuple(self.values))


class SimulatedTarget(Wire):
    """The hidden truth of the task's variant, in simulation."""

    kind: Literal["simulated"] = "simulated"
    program: ClassVar[str | None] = None  # the method's
    effects: list[Effect] = Field(
        default=[], max_length=100, description="that it has, and the source's file lacks"
    )


class RecordedTarget(Wire):
    """No target at all, but a stored recording, from which an offline method learns once."""

    kind: Literal["recorded"] = "recorded"
    program: ClassVar[str | None] = "adr_service.programs.recorded"
    dataset: Name = Field(description="id of an uploaded recording")
    episodes: int | None = Field(
        None, ge=1, lt=2**31, description="the first so many; default: all"
    )


class ExternalTarget(Wire):
    """A real robot, or any machine, whose client asks the service for episodes to run."""

    kind: Literal["external"] = "external"
    program: ClassVar[str | None] = None  # the method's


AnyTarget = Annotated[
    SimulatedTarget | RecordedTarget | ExternalTarget, Field(discriminator="kind")
]
EXTERNAL_EPISODES = 5  # of the final evaluation: a robot's time is dear


class RunSpec(Wire):
    """One method on one task variant with one seed."""

    kind: Literal["transfer"] = "transfer"
    task: TaskName
    variant: VariantName = Field("vanilla", validate_default=True)
    method: Annotated[AnyMethod, BeforeValidator(_known_method)]
    target: AnyTarget = SimulatedTarget()
    extension: list[Effect] = Field(
        default=[],
        max_length=100,
        description="effects that the source is extended by, as `adr criticise` writes them",
    )
    collector: Literal[Collector, "recording"] = Field(
        "simopt",
        description="whose actions offline methods see: SimOpt's policies' (the protocol), the "
        "prior's policy's, random ones (the data-collection study), or those of a recorded target",
    )
    simopt: SimOptSettings | None = Field(
        None, description="whose trajectories an offline method learns from; default: the preset's"
    )
    seed: Seed = 0
    preset: PresetName = "quick"
    iterations: int = Field(ge=1, le=100, description="target rollouts a method may use")
    transitions: int = Field(ge=1, le=100_000, description="per target rollout, at most")
    evaluation_episodes: int = Field(ge=2, le=10_000, description="final, seen by no method")
    training: TrainingSettings

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        given = {name: _as_given(value) for name, value in cast(dict[str, Any], given).items()}
        name = given.get("preset", "quick")
        # a wrong one is refused by its field, and no other field shall look wrong beside it
        preset = PRESETS[name if isinstance(name, str) and name in PRESETS else "quick"]
        filled = {"preset": "quick", **preset["run"], **given}
        if isinstance(training := given.get("training", {}), dict):
            filled["training"] = {**preset["run"]["training"], **training}
        if "method" in given:
            filled["method"] = _fill_method(given["method"], preset["methods"])
        target = filled.get("target")
        kind = cast(dict[str, Any], target).get("kind") if isinstance(target, dict) else None
        if kind == "external" and "evaluation_episodes" not in given:
            filled["evaluation_episodes"] = EXTERNAL_EPISODES
        if kind == "recorded":
            filled.setdefault("collector", "recording")
        simopt = given.get("simopt")
        if simopt is None and _learns_from_simopt(filled):
            simopt = {}
        if isinstance(simopt, str):
            simopt = {"name": simopt}
        if isinstance(simopt, dict):
            filled["simopt"] = {**preset["methods"].get("simopt", {}), **simopt}
        return filled

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """What may be given, of which the preset fills the rest, as `_fill_from_preset` does."""
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
    def _possible_on_the_task(self) -> Self:
        pair, task = variant_of(self.task, self.variant), get_task(self.task)
        for name, source, effects in (
            ("extension", pair.source, self.extension),
            ("target.effects", pair.hidden.source, self.hidden_effects),
        ):
            try:
                check_effects(task, replace(source, causes=tuple(e.cause for e in effects)))
            except AdrError as error:
                raise ValueError(f"{name}: {error}") from error
        horizon = task.horizon
        if self.transitions > horizon:
            raise ValueError(
                f"transitions: {self.transitions} given, but an episode of {self.task} has "
                f"{horizon} steps at most"
            )
        offline = self.method.learns_from == "recordings"
        if not offline and isinstance(self.target, RecordedTarget):
            raise ValueError(
                f"method: {self.method.name} needs a target that it can visit; a recorded one "
                f"serves {', '.join(names_of('recordings'))}"
            )
        if self.method.needs_truth and not isinstance(self.target, SimulatedTarget):
            raise ValueError(
                f"method: nobody knows the truth that the {self.method.name} would be trained on"
            )
        if (self.collector == "recording") != isinstance(self.target, RecordedTarget):
            raise ValueError(
                f"collector: {self.collector!r} given, with a {self.target.kind} target; "
                "'recording' goes with a recorded one, and nothing else does"
            )
        if self.collector != "simopt" and not offline:
            raise ValueError(
                f"collector: {self.collector!r} given, but only "
                f"{', '.join(names_of('recordings'))} learn from what another policy collects"
            )
        if (self.simopt is not None) != (offline and self.collector == "simopt"):
            raise ValueError(
                "simopt: given, but this run learns nothing from SimOpt's trajectories"
            )
        return self

    @property
    def program(self) -> str:
        """The module of the program that runs it."""
        return self.target.program or self.method.program

    @property
    def source_domain(self) -> str:
        """What methods may simulate."""
        return domain_of(self.variant, [effect.cause for effect in self.extension])

    @property
    def target_domain(self) -> str:
        """What they are judged on."""
        return domain_of(self.variant, [effect.cause for effect in self.hidden_effects])

    @property
    def hidden_effects(self) -> list[Effect]:
        """What the simulated target has and its file lacks."""
        return self.target.effects if isinstance(self.target, SimulatedTarget) else []

    @property
    def dataset(self) -> str | None:
        """The id of the stored recording that it learns from."""
        return self.target.dataset if isinstance(self.target, RecordedTarget) else None

    @property
    def label(self) -> str:
        """What is done, in a word."""
        return self.method.name

    @property
    def column(self) -> str:
        """The method, and who collects for it where that is not as in the protocol."""
        return self.method.name + ("" if self.collector == "simopt" else f" on {self.collector}")


class CriticismSpec(Wire):
    """What a stored measurement says that a task's simulator gets wrong."""

    kind: Literal["criticism"] = "criticism"
    program: ClassVar[str] = "adr_service.programs.criticism"
    task: TaskName
    variant: VariantName = Field("vanilla", validate_default=True)
    dataset: Name = Field(description="id of an uploaded measurement")
    seed: Seed = Field(0, description="of the bootstraps")

    @property
    def label(self) -> str:
        return self.kind


AnyRun = Annotated[RunSpec | CriticismSpec, Field(discriminator="kind")]


T = TypeVar("T")
Budget = Annotated[int, Field(lt=2**31)]  # each run has closer limits
Members = Annotated[list[T], Field(max_length=MAX_RUNS)]


class BenchmarkExtension(Wire):
    """What to add to a benchmark."""

    tasks: Members[TaskName] = Field([])
    variants: Members[Name] = Field([])
    methods: Members[NameOrSettings] = Field([])
    collectors: Members[Collector] = Field([])
    seeds: Members[Seed] = Field([])


class BenchmarkSpec(Wire):
    """Tasks x variants x methods x seeds under one budget."""

    tasks: Members[TaskName] = Field(min_length=1)
    variants: Members[VariantName] = Field(default=["vanilla"], min_length=1)
    methods: Members[NameOrSettings] = Field(min_length=1)
    collectors: Members[Collector] = Field(
        default=["simopt"], min_length=1, description="for offline methods; others run once"
    )
    seeds: Members[Seed] = Field(default=[0, 1, 2], min_length=1)
    references: bool = Field(True, description="also run the prior and the oracle policy")
    preset: PresetName = "quick"
    iterations: Budget | None = None
    transitions: Budget | None = None
    evaluation_episodes: Budget | None = None
    training: dict[Name, Any] | None = Field(None, max_length=100)

    @model_validator(mode="after")
    def _all_runs_are_valid(self) -> Self:
        if self.size > MAX_RUNS:
            raise ValueError(f"a benchmark may have {MAX_RUNS} runs at most; this has {self.size}")
        for name in ("tasks", "variants", "methods", "collectors", "seeds"):
            values = [getattr(m, "name", m) for m in getattr(self, name)]
            if repeated := [value for value, count in Counter(values).items() if count > 1]:
                raise ValueError(f"{name} must not repeat a member; {repeated[0]!r} comes twice")
        list(self.runs())
        return self

    @property
    def size(self) -> int:
        """The number of runs."""
        columns = sum(len(self._collectors_of(method)) for method in self._all_methods)
        return len(self.tasks) * len(self.variants) * len(self.seeds) * columns

    def _collectors_of(self, method: Any) -> list[Collector]:
        name = method if isinstance(method, str) else method.name
        return self.collectors if name in names_of("recordings") else ["simopt"]

    @property
    def _all_methods(self) -> list[Any]:
        named = [m if isinstance(m, str) else m.name for m in self.methods]
        known = methods().items() if self.references else ()
        references = [name for name, settings in known if settings.is_reference]
        return [*self.methods, *(name for name in references if name not in named)]

    def extended(self, extension: BenchmarkExtension) -> "BenchmarkSpec":
        """This benchmark and more; what it has already cannot be added again."""
        added = {name: list(value) for name, value in extension if value}
        if not added:
            accepted = ", ".join(BenchmarkExtension.model_fields)
            raise InvalidInput(f"nothing to add was given; accepted: {accepted}")
        wider = {name: [*getattr(self, name), *value] for name, value in added.items()}
        try:
            return BenchmarkSpec.model_validate(self.model_dump(exclude_unset=True) | wider)
        except ValidationError as error:
            raise InvalidInput(explain(error, "benchmark")) from error

    def runs(self) -> Iterator[RunSpec]:
        """The runs, seeds outermost, so that a stopped benchmark has whole repetitions."""
        budget = ("iterations", "transitions", "evaluation_episodes", "training")
        given = {name: getattr(self, name) for name in budget if getattr(self, name) is not None}
        own = next((m for m in self.methods if not isinstance(m, str) and m.collects), None)
        simopt = {} if own is None else {"simopt": _as_given(own)}
        chosen = [(m, c) for m in self._all_methods for c in self._collectors_of(m)]
        for seed, task, variant, (method, collector) in product(
            self.seeds, self.tasks, self.variants, chosen
        ):
            # what was not given of a method's settings is the preset's, not the class's default
            who = {"method": _as_given(method), "collector": collector}
            yield RunSpec.model_validate(
                {
                    "task": task,
                    "variant": variant,
                    **who,
                    "seed": seed,
                    "preset": self.preset,
                    **given,
                }
                | (simopt if _learns_from_simopt(who) else {})
            )


def _as_given(value: Any) -> Any:
    """What was given of a value of ours, and what it is, as JSON; others as they are."""
    if not isinstance(value, Wire):
        return value
    tags = [tag for tag in ("name", "kind") if tag in type(value).model_fields]
    return {tag: getattr(value, tag) for tag in tags} | value.model_dump(exclude_unset=True)


def _fill_method(given: Any, defaults: dict[str, dict[str, Any]]) -> Any:
    """A method's settings from its name or its partial settings, and the preset's."""
    if isinstance(given, str) and given in methods():
        given = {"name": given}
    if isinstance(given, dict) and isinstance(name := given.get("name"), str):
        return {**defaults.get(name, {}), **given}
    return given


def _learns_from_simopt(spec: dict[str, Any]) -> bool:
    """Whether a spec, perhaps not valid, is of an offline method that sees SimOpt's data."""
    method = spec.get("method")
    name = cast(dict[str, Any], method).get("name") if isinstance(method, dict) else method
    return name in names_of("recordings") and spec.get("collector", "simopt") == "simopt"

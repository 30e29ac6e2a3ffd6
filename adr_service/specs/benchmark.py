"""Specs of benchmarks: a grid of runs under one budget."""

from collections import Counter
from collections.abc import Iterator
from itertools import product
from typing import Annotated, Any, Self, TypeVar

from pydantic import Field, ValidationError, model_validator

from adr_service.errors import InvalidInput
from adr_service.json_values import Wire, explain
from adr_service.methods.catalogue import methods, names_of
from adr_service.specs.filling import learns_from_simopt
from adr_service.specs.names import (
    Collector,
    Name,
    NameOrSettings,
    PresetName,
    Resolution,
    Seed,
    TaskName,
    VariantName,
    as_given,
)
from adr_service.specs.run import RunSpec

MAX_RUNS = 5000  # of one benchmark
T = TypeVar("T")
Budget = Annotated[int, Field(lt=2**31)]  # each run has closer limits
Members = Annotated[list[T], Field(max_length=MAX_RUNS)]


class BenchmarkExtension(Wire):
    """Members to add to a benchmark."""

    tasks: Members[TaskName] = Field([], description="tasks to add")
    variants: Members[Name] = Field([], description="variants to add")
    methods: Members[NameOrSettings] = Field([], description="methods to add, as in a benchmark")
    collectors: Members[Collector] = Field([], description="collectors to add")
    seeds: Members[Seed] = Field([], description="seeds to add")


class BenchmarkPart(Wire):
    """Names of the members of a benchmark to keep; an empty list keeps all of its kind."""

    tasks: Members[str] = Field(default=[], description="only these tasks")
    variants: Members[str] = Field(default=[], description="only these variants")
    methods: Members[str] = Field(default=[], description="only these methods, and the references")
    collectors: Members[str] = Field(
        default=[], description="only these collectors, and methods without one"
    )
    seeds: Members[str] = Field(default=[], description="only these seeds")

    @property
    def is_whole(self) -> bool:
        """True if it leaves nothing out."""
        return not any(names for _, names in self)


def members_of(spec: "BenchmarkSpec | BenchmarkExtension") -> dict[str, dict[str, Any]]:
    """The members of each kind ("tasks", "variants", …) by their names."""
    kinds = BenchmarkExtension.model_fields
    return {kind: {_name(member): member for member in getattr(spec, kind)} for kind in kinds}


def _name(member: Any) -> str:
    return str(getattr(member, "name", member))


class BenchmarkSpec(Wire):
    """Tasks x variants x methods x seeds under one budget."""

    tasks: Members[TaskName] = Field(min_length=1, description="each runs in every variant")
    variants: Members[VariantName] = Field(
        default=["vanilla"], min_length=1, description="each runs with every method"
    )
    methods: Members[NameOrSettings] = Field(
        min_length=1, description="names, or settings with `name`"
    )
    collectors: Members[Collector] = Field(
        default=["simopt"], min_length=1, description="for offline methods; others run once"
    )
    seeds: Members[Seed] = Field(
        default=[0, 1, 2], min_length=1, description="one run each; an interval needs three"
    )
    references: bool = Field(True, description="also run the prior and the oracle policy")
    preset: PresetName = "quick"
    iterations: Budget | None = Field(None, description="as in a run; null: the preset's")
    transitions: Budget | None = Field(None, description="as in a run; null: the preset's")
    evaluation_episodes: Budget | None = Field(None, description="as in a run; null: the preset's")
    training: dict[Name, Any] | None = Field(
        None, max_length=100, description="as in a run; null: the preset's"
    )
    resolution: Resolution | None = Field(None, description="as in a run")

    @model_validator(mode="after")
    def _all_runs_are_valid(self) -> Self:
        if self.size > MAX_RUNS:
            raise ValueError(f"a benchmark may have {MAX_RUNS} runs at most; this has {self.size}")
        for kind in BenchmarkExtension.model_fields:
            names = Counter(map(_name, getattr(self, kind)))
            if repeated := [name for name, count in names.items() if count > 1]:
                why = f"{repeated[0]} comes twice"
                hint = "; submit each setting of a method as a benchmark" * (kind == "methods")
                raise ValueError(f"{kind} must not repeat a member; {why}{hint}")
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
    def method_names(self) -> list[str]:
        """The methods that were asked for, by name."""
        return [m if isinstance(m, str) else m.name for m in self.methods]

    @property
    def _all_methods(self) -> list[Any]:
        named = self.method_names
        known = methods().items() if self.references else ()
        references = [name for name, settings in known if settings.is_reference]
        return [*self.methods, *(name for name in references if name not in named)]

    def extended(self, extension: BenchmarkExtension) -> "BenchmarkSpec":
        """This benchmark with more members; those that it has already cannot be added again."""
        added = {kind: members for kind, members in extension if members}
        if not added:
            accepted = ", ".join(BenchmarkExtension.model_fields)
            raise InvalidInput(f"nothing to add was given; accepted: {accepted}")
        for kind, mine in members_of(self).items():
            if again := [name for name in members_of(extension)[kind] if name in mine]:
                raise InvalidInput(
                    f"the benchmark has the {kind} {', '.join(again)} already; leave them out: "
                    "what is added runs with all that is there"
                )
        return self._with({kind: [*getattr(self, kind), *new] for kind, new in added.items()})

    def part(self, chosen: BenchmarkPart) -> "BenchmarkSpec":
        """This benchmark with some of its members alone."""
        kept: dict[str, list[Any]] = {}
        for kind, members in members_of(self).items():
            names = getattr(chosen, kind)
            if unknown := [name for name in names if name not in members]:
                raise InvalidInput(
                    f"the benchmark has no {kind} {', '.join(unknown)}; it has {', '.join(members)}"
                )
            if names and members.keys() - set(names):
                kept[kind] = [members[name] for name in members if name in names]
        return self._with(kept)

    def joined(self, other: "BenchmarkSpec") -> "BenchmarkSpec":
        """This benchmark with the members of another one too."""
        wider: dict[str, list[Any]] = {}
        for kind, mine in members_of(self).items():
            theirs = members_of(other)[kind]
            if theirs.keys() - mine.keys():
                wider[kind] = list((mine | theirs | mine).values())  # with our own settings
        return self._with(wider)

    def _with(self, members: dict[str, list[Any]]) -> "BenchmarkSpec":
        try:
            return BenchmarkSpec.model_validate(self.model_dump(exclude_unset=True) | members)
        except ValidationError as error:
            raise InvalidInput(explain(error, "benchmark")) from error

    def runs(self) -> Iterator[RunSpec]:
        """The runs, seeds outermost, so that a stopped benchmark has whole repetitions."""
        budget = ("iterations", "transitions", "evaluation_episodes", "training", "resolution")
        given = {name: getattr(self, name) for name in budget if getattr(self, name) is not None}
        own = next((m for m in self.methods if not isinstance(m, str) and m.collects), None)
        simopt = {} if own is None else {"simopt": as_given(own)}
        chosen = [(m, c) for m in self._all_methods for c in self._collectors_of(m)]
        for seed, task, variant, (method, collector) in product(
            self.seeds, self.tasks, self.variants, chosen
        ):
            # fields that a method's settings leave out are the preset's, not the class's defaults
            who = {"method": as_given(method), "collector": collector}
            cell = {"task": task, "variant": variant, "seed": seed, "preset": self.preset}
            own_simopt = simopt if learns_from_simopt(who) else {}
            yield RunSpec.model_validate({**cell, **who, **given, **own_simopt})

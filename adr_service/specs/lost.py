"""Stored specs that cannot be read any more: a package was uninstalled, or has other settings now.

They are listed beside all others with what is known of them, and nothing can be computed of them.
Of runs whose task's package has another version now, only the distributions cannot be read.
"""

from typing import Any, ClassVar, Literal, cast

from pydantic import ValidationError

from adr_service.errors import AdrError, FailureCode
from adr_service.json_values import Wire, explain
from adr_service.methods.catalogue import methods
from adr_service.plugins import OtherVersion
from adr_service.specs.benchmark import BenchmarkSpec
from adr_service.tasks.catalogue import catalogue


class LostRun(Wire):
    """A stored run whose spec cannot be read any more."""

    kind: Literal["lost"] = "lost"
    program: ClassVar[str] = "adr_service.programs.lost"
    task: str
    variant: str
    method: str
    seed: int
    dataset: str | None
    reason: str

    @property
    def label(self) -> str:
        """The method, for lists of runs."""
        return self.method

    @property
    def column(self) -> str:
        """The method."""
        return self.method


class LostBenchmark(Wire):
    """A stored benchmark whose spec cannot be read any more."""

    kind: Literal["lost"] = "lost"
    tasks: list[str]
    variants: list[str]
    methods: list[str]
    seeds: list[int]
    preset: str
    reason: str

    @classmethod
    def of(cls, document: dict[str, Any], error: ValidationError) -> "LostBenchmark":
        """The fields that can still be read; raises ValidationError if it is no benchmark."""
        names = ("tasks", "variants", "seeds", "preset")
        usual = {name: BenchmarkSpec.model_fields[name].get_default() for name in names[1:]}
        known = {name: document.get(name, usual.get(name)) for name in names}
        methods = [_name(each) for each in _listed(document, "method")]
        reason = reason_of(document, error)
        return cls.model_validate({**known, "methods": methods, "reason": reason})


def reason_of(document: dict[str, Any], error: ValidationError) -> str:
    """Why a stored run's or benchmark's spec is lost, and what helps."""
    named, tasks = (map(_name, _listed(document, kind)) for kind in ("method", "task"))
    lacking = [f"the method {name!r}" for name in named if name not in methods()]
    lacking += [f"the task {name!r}" for name in tasks if name not in catalogue()]
    if not lacking:
        return f"its spec is of another version: {explain(error, 'spec')}"
    verb, them = ("is", "it") if len(lacking) == 1 else ("are", "them")
    return (
        f"{' and '.join(lacking)} {verb} not installed here: install the package that has {them}, "
        "and start the service again"
    )


def reason_of_distributions(other: OtherVersion) -> str:
    """Why a finished run's distributions cannot be read, and what helps.

    Their numbers mean something in the task's parameter space of that version alone.
    """
    return (
        f"computed with {other.of_stage}, and {other.here} is installed: install the former again "
        "to see its distributions"
    )


class Lost(AdrError):
    """A stored spec or distribution cannot be used before its package is installed again."""

    code = FailureCode.LOST_SPEC


def _listed(document: dict[str, Any], kind: str) -> list[Any]:
    """The method or task of a run, or those of a benchmark."""
    given = document.get(f"{kind}s", [document[kind]] if kind in document else [])
    return cast(list[Any], given) if isinstance(given, list) else []


def _name(given: Any) -> str:
    """The name of what is given by name, or by settings."""
    return str(cast(dict[str, Any], given).get("name") if isinstance(given, dict) else given)

"""Targets of runs: simulated, recorded, or a machine outside."""

from typing import Annotated, Any, ClassVar, Literal, cast, get_args

from pydantic import BeforeValidator, Field

from adr_service.effects.base import Effect
from adr_service.json_values import Wire
from adr_service.specs.names import Name


class SimulatedTarget(Wire):
    """The hidden truth of the task's variant, in simulation."""

    kind: Literal["simulated"] = "simulated"
    program: ClassVar[str | None] = None  # the method's
    effects: list[Effect] = Field(
        default=[], max_length=100, description="effects of the target that the source's file lacks"
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


_OneOfThem = SimulatedTarget | RecordedTarget | ExternalTarget
_KINDS = [str(each.model_fields["kind"].default) for each in get_args(_OneOfThem)]


def _with_known_kind(given: Any) -> Any:
    """Return a target as given; raises ValueError with all kinds, where Pydantic speaks of tags."""
    if isinstance(given, dict) and cast(dict[Any, Any], given).get("kind") not in _KINDS:
        raise ValueError(f"the 'kind' of a target is one of {', '.join(_KINDS)}")
    return cast(Any, given)


AnyTarget = Annotated[_OneOfThem, Field(discriminator="kind"), BeforeValidator(_with_known_kind)]
EXTERNAL_EPISODES = 5  # of the final evaluation: a robot's time is dear

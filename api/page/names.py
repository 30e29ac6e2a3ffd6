"""Names of runs for people, and seeds as people write them."""

from collections.abc import Iterable
from contextlib import suppress

from adr_service.errors import InvalidInput
from adr_service.specs import AnyRun, CriticismSpec, LostRun, RunSpec
from api.service import Service
from db import runs as run_store
from db.errors import NotFound

_LONGEST = 10  # digits of a seed


def title_of(spec: AnyRun | LostRun) -> str:
    """A run in a few words."""
    if isinstance(spec, CriticismSpec):
        return f"Criticism of {spec.task}, {spec.variant}"
    return f"{spec.column} on {spec.task}, {spec.variant}, seed {spec.seed}{apart_of(spec)}"


def apart_of(spec: AnyRun | LostRun) -> str:
    """The words of a title for an extended simulator or an unusual target; else none."""
    return spec.suffix if isinstance(spec, RunSpec) else ""


def titles(service: Service, ids: Iterable[str]) -> dict[str, str]:
    """The titles of runs by id, without those of runs that are deleted."""
    found: dict[str, str] = {}
    for id in set(ids):
        with suppress(NotFound):
            found[id] = title_of(run_store.get_run(service.database, id).spec)
    return found


def numbers_in(text: str) -> list[int]:
    """Seeds with spaces or commas between; raises InvalidInput."""
    parts = text.replace(",", " ").split()
    if wrong := [part for part in parts if not part.isdecimal() or len(part) > _LONGEST]:
        raise InvalidInput(f"seeds are whole numbers, as 0 1 2; given {wrong[0][:20]!r}")
    return [int(part) for part in parts]

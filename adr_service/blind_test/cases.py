"""Cases of a blind test, drawn at random, and the key that says what they hide."""

from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field

from adr_service.blind_test.outside import Outside
from adr_service.blind_test.planting import Case, draw_case
from adr_service.criticism.nominal import Nominal
from adr_service.effects.base import Effect
from adr_service.errors import AdrError, InvalidInput, UnknownName
from adr_service.json_values import Wire
from adr_service.tasks.catalogue import get_task, source_of

TASKS = ("arm", "hopper", "half_cheetah", "walker2d")
RATIOS = (0.03, 0.1, 0.3, 1.0)
Kind = Literal["none", "outside", "two", "one"]
_MOST_DRAWS = 1000
_SHARES = (0.20, 0.15, 0.05, 0.60)  # of all cases, by kind


class Hidden(Wire):
    """Key entry of one case."""

    task: str
    kind: Annotated[Kind, Field(description="nothing, an effect outside the catalogue, two, one")]
    ratio: Annotated[float, Field(description="of an effect to the noise; 0: nothing is hidden")]
    effects: Annotated[tuple[Effect, ...], Field(strict=False)]
    outside: Outside | None


def check_task(name: str) -> None:
    """Raises UnknownName for a task that has no blind test."""
    if name not in TASKS:
        raise UnknownName("task of a blind test", name, TASKS)


def draw_blind(task: str, rng: np.random.Generator) -> tuple[Hidden, Case]:
    """A random case of a task, and what it hides."""
    kind: Kind = str(rng.choice(get_args(Kind), p=_SHARES))  # pyright: ignore[reportAssignmentType]
    ratio = float(rng.choice(RATIOS)) if kind != "none" else 0.0
    case = _drawn(task, kind, ratio, rng)
    hidden = Hidden(task=task, kind=kind, ratio=ratio, effects=case.effects, outside=case.outside)
    return hidden, case


def _drawn(name: str, kind: Kind, ratio: float, rng: np.random.Generator) -> Case:
    """The first case that can be simulated."""
    task = get_task(name)
    nominal = Nominal.of_task(task, source_of(name, "vanilla"))
    count = {"one": 1, "two": 2}.get(kind, 0)
    for _ in range(_MOST_DRAWS):
        try:
            return draw_case(task, nominal, rng, ratio, count, kind == "outside")
        except AdrError:
            continue  # it diverged, or nothing in its motions can be of this ratio
    raise InvalidInput(
        f"{_MOST_DRAWS} robots in a row that {name} may hide diverged, or moved so that nothing "
        f"can be of ratio {ratio:g}"
    )

"""Uniform domain randomization (UDR): the baseline that learns from no data.

Tiboni et al., the benchmark's paper, Sec. 3.2: the mean over policies that are trained on uniform
bounds, drawn at random within the search space.

The paper does not state how it draws the bounds. Here each parameter has two uniform draws, sorted.
"""

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.distributions import Uniform
from adr_service.methods.base import Data, MethodSettings
from adr_service.parameters import ParameterSpace


class UdrSettings(MethodSettings):
    name: Literal["udr"] = "udr"
    policies: int = Field(10, ge=1, le=1000, description="random bounds, one policy each")

    program: ClassVar[str] = "adr_service.programs.udr"
    learns_from: ClassVar[Data] = "nothing"
    is_level: ClassVar[bool] = True
    label: ClassVar[str] = "UDR"
    colour: ClassVar[str] = "#E69F00"


def random_bounds(
    space: ParameterSpace, settings: UdrSettings, rng: np.random.Generator
) -> list[Uniform]:
    """`settings.policies` random boxes inside the search bounds (Sec. 3.2)."""
    corners = np.sort(
        rng.uniform(space.low, space.high, (settings.policies, 2, len(space))), axis=1
    )
    return [Uniform(space, low, high) for low, high in corners]

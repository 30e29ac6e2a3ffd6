"""BayRn: choose the distribution to train on by Bayesian optimisation of the target's return.

Muratore et al.: "Data-efficient Domain Randomization with Bayesian Optimization", arXiv
2003.02471, as the benchmark adapts it (Tiboni et al., Sec. 3.2): uniform source distributions,
a Gaussian process that starts from UDR's policies and their target returns and nothing else, and
one more policy per iteration. It looks at returns alone, never at transitions.

What the benchmark does not state, and is chosen here: Matern-5/2 with a length scale per
coordinate; expected improvement (in logarithms, for its numerics); bounds as position and width,
so that every point of the cube is a valid distribution and none has two names; one full target
episode per policy; the policy reported at an iteration is the one, of all so far, with the
highest posterior mean.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from adr_service.arrays import Matrix, Vector
from adr_service.distributions import Uniform
from adr_service.methods.base import Data, MethodSettings
from adr_service.parameters import ParameterSpace
from adr_service.startup_time import preparing


class BayRnSettings(MethodSettings):
    name: Literal["bayrn"] = "bayrn"
    initial: int = Field(10, ge=2, le=1000, description="policies of UDR to start from")

    program: ClassVar[str] = "adr_service.programs.bayesian"
    learns_from: ClassVar[Data] = "returns"
    label: ClassVar[str] = "BayRn"
    colour: ClassVar[str] = "#999933"


@dataclass(frozen=True)
class Proposal:
    """What the returns so far suggest."""

    next: Uniform  # to train on next
    best: int  # index of the distribution whose policy is believed best
    means: Vector  # (n,) posterior means of those so far


def propose(boxes: list[Uniform], returns: Vector, rng: np.random.Generator) -> Proposal:
    """Where to look after `boxes` earned `returns` (n,) on the target."""
    # importing BoTorch takes seconds: only who optimises pays
    with preparing():
        from adr_service.search.bayesian import Surrogate

    points = np.array([encode(box) for box in boxes])
    surrogate = Surrogate(points, returns, rng)
    means = surrogate.mean(points)
    return Proposal(decode(boxes[0].space, surrogate.propose()), int(np.argmax(means)), means)


def encode(box: Uniform) -> Vector:
    """Bounds as (2d,) in [0, 1]: where the interval stands in its room, then how wide it is."""
    low, high = box.space.low, box.space.high
    width = (box.high - box.low) / (high - low)
    room = (high - low) - (box.high - box.low)
    with np.errstate(invalid="ignore", divide="ignore"):
        position = np.where(room > 0, (box.low - low) / room, 0.5)
    return np.concatenate([position, width])


def decode(space: ParameterSpace, point: Matrix) -> Uniform:
    """The inverse of `encode`, for every point of the cube."""
    position, width = np.split(np.asarray(point), 2)
    ranges = space.high - space.low
    low = space.low + position * (1 - width) * ranges
    return Uniform(space, low, np.minimum(low + width * ranges, space.high))

"""What a criticism found: causes with their evidence, or none, or that none of ours explains it.

`Verdict.to_json` is the file `verdict.json`, version 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal

from adr_service.arrays import Matrix, Vector

VERSION = 1
_SEEN = 2.0  # expected errors of one step, on average over an experiment
Finding = Literal["cause", "none", "unknown", "tie"]


@dataclass(frozen=True)
class Estimate:
    """A strength with its 95 % interval, unbounded where the data say nothing of it."""

    name: str  # of the strength, and in a group also of its place
    value: float
    low: float
    high: float
    unit: str

    def to_json(self) -> dict[str, Any]:
        low, high = (bound if isfinite(bound) else None for bound in (self.low, self.high))
        return {"value": self.value, "low": low, "high": high, "unit": self.unit}

    @property
    def interval(self) -> str:
        """The interval in words."""
        return f"{self.low:.4g} to {self.high:.4g}" if isfinite(self.high) else "cannot be told"


@dataclass(frozen=True)
class NamedCause:
    """An effect that the simulator lacks, at its place."""

    kind: str
    location: str  # of a group `body:*`
    strengths: tuple[Estimate, ...]  # in the mechanism's order; of a group place by place
    confidence: float  # probability, among everything that was asked
    gain: float  # nats by which episodes are predicted better that no fit has seen

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "location": self.location,
            "parameters": {estimate.name: estimate.to_json() for estimate in self.strengths},
            "confidence": self.confidence,
            "gain_nats": self.gain,
        }


@dataclass(frozen=True)
class Experiment:
    """The best one we know, and how far it separates two simulators."""

    description: str
    separation: float  # root mean square difference, in expected errors of one step
    recorded: float  # the same on the recorded episodes

    @property
    def is_worth_it(self) -> bool:
        return self.separation > max(_SEEN, self.recorded)

    @property
    def is_seen(self) -> bool:
        """Whether anything that was tried or recorded separates the two at all."""
        return max(self.separation, self.recorded) > _SEEN

    def to_json(self) -> dict[str, Any]:
        return {
            "description": self.description,
            "separation": self.separation,
            "recorded": self.recorded,
            "is_worth_it": self.is_worth_it,
        }


@dataclass(frozen=True)
class Residual:
    """What is left when all is said."""

    noise: tuple[float, ...]  # standard deviation of each sensor, in its unit
    step: float  # [s] of the simulator, with which all this was judged
    own_step: float  # [s] that its file has
    unexplained_nats: float  # what a flexible force would still gain
    rest: Literal["none", "unknown"]  # whether that counts, beside what was named
    moved: dict[str, tuple[float, float]]  # parameter -> fitted without and with the causes
    at_bound: tuple[str, ...]  # parameters that went as far as they may
    used: int  # transitions
    diverged: int  # transitions that could not be simulated, and were left out
    # "kind location" -> smallest first strength that would have been seen, and its unit
    detectable: dict[str, tuple[float, str]]

    def to_json(self) -> dict[str, Any]:
        return {
            "sensor_noise": list(self.noise),
            "timestep": {"judged_with": self.step, "of_the_model": self.own_step},
            "unexplained_nats": self.unexplained_nats,
            "rest": self.rest,
            "parameters": {
                name: {"without": before, "with": after, "at_bound": name in self.at_bound}
                for name, (before, after) in self.moved.items()
            },
            "transitions": {"used": self.used, "diverged": self.diverged},
            "detectable": {
                name: {"value": size, "unit": unit}
                for name, (size, unit) in self.detectable.items()
            },
        }


@dataclass(frozen=True)
class Trace:
    """An episode that nothing was fitted to, simulated from its first state on; (T, m) each."""

    time: Vector  # (T,) [s]
    measured: Matrix
    without: Matrix
    with_causes: Matrix


@dataclass(frozen=True)
class Gain:
    """What the causes are worth on episodes that were opened once, at the end."""

    sse_removed: float  # share of the squared innovations
    low: float  # 95 % bootstrap over episodes
    high: float
    explainable_fraction: float | None  # of what is beyond the final noise; None: nothing is
    horizons: dict[
        int, tuple[float, float]
    ]  # control steps -> error without and with, in those units
    diverged: tuple[int, int]  # transitions that cannot be simulated, without and with
    trace: Trace  # for the eye alone

    def to_json(self) -> dict[str, Any]:
        return {
            "sse_removed": self.sse_removed,
            "low": self.low,
            "high": self.high,
            "explainable_fraction": self.explainable_fraction,
            "diverged": {"without": self.diverged[0], "with": self.diverged[1]},
            "error_by_horizon": {
                str(steps): {"without": before, "with": after}
                for steps, (before, after) in self.horizons.items()
            },
        }


@dataclass(frozen=True)
class Verdict:
    finding: Finding
    confidence: float
    causes: tuple[NamedCause, ...]
    tied: tuple[tuple[NamedCause, ...], ...]  # what would explain a cause as well, cause by cause
    # of each of those, what would tell it apart from the named one
    experiments: tuple[tuple[Experiment, ...], ...]
    residual: Residual
    gain: Gain | None  # None: nothing was named that predictions would gain from
    remarks: tuple[str, ...]  # on the data, in words
    seconds: float | None  # by the clock; None of a stage, whose cost is kept beside it

    def to_json(self) -> dict[str, Any]:
        return {
            "version": VERSION,
            "verdict": self.finding,
            "confidence": self.confidence,
            "causes": _all(self.causes),
            "tied": [_all(group) for group in self.tied],
            "experiments": [[each.to_json() for each in group] for group in self.experiments],
            "residual": self.residual.to_json(),
            "gain": None if self.gain is None else self.gain.to_json(),
            "remarks": list(self.remarks),
            "seconds": self.seconds,
        }


def _all(causes: Sequence[NamedCause]) -> list[dict[str, Any]]:
    return [cause.to_json() for cause in causes]

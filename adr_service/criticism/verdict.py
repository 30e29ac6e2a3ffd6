"""The result of a criticism: causes with their evidence, or none, or none that we know.

`Verdict.to_json` is the file `verdict.json`, version 1.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from math import isfinite
from typing import Any, Literal

from adr_service.arrays import Matrix, Vector

VERSION = 1
_DIGITS = range(4, 10)  # significant ones of an interval
_DECIMALS = range(1, 6)  # of a percentage with its interval
_SEEN = 2.0  # expected errors of one step, on average over an experiment


class Conclusion(StrEnum):
    """The four ways in which a criticism ends."""

    CAUSE = "cause"  # each missing effect has one best explanation
    TIE = "tie"  # several effects explain one of them equally well
    NONE = "none"  # nothing is missing that the data could show
    UNKNOWN = "unknown"  # something is missing that is not in the catalogue


def quantity_text(value: float, unit: str) -> str:
    """A value with its unit; "1" is none."""
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"


def interval_text(low: float | None, high: float | None) -> str:
    """An interval with as many digits as its ends need to differ; None: unbounded."""
    if high is None:
        return "not determined"
    if low is None:
        return f"-∞ to {high:.4g}"
    texts = ((f"{low:.{n}g}", f"{high:.{n}g}") for n in _DIGITS)
    one, other = next((ends for ends in texts if ends[0] != ends[1]), (f"{low:.4g}",) * 2)
    return f"{one} to {other}"


def share_text(share: float, low: float, high: float) -> str:
    """A share and its interval in percent, with the decimals that the ends need to differ.

    Ends that are equal are said once, as the share.
    """
    for decimals in _DECIMALS:
        text, *ends = (f"{100 * value:.{decimals}f}" for value in (share, low, high))
        if ends[0] != ends[1]:
            return f"{text} % [{ends[0]}, {ends[1]}]"
    return f"{100 * share:.6g} %"


@dataclass(frozen=True)
class StrengthInterval:
    """A strength with its 95 % interval, unbounded if the data do not determine it."""

    name: str  # of the strength; in a group, after its place
    value: float
    low: float
    high: float
    unit: str

    def to_json(self) -> dict[str, Any]:
        low, high = (bound if isfinite(bound) else None for bound in (self.low, self.high))
        return {"value": self.value, "low": low, "high": high, "unit": self.unit}

    @property
    def interval(self) -> str:
        """Text of the interval."""
        bounds = self.to_json()
        return interval_text(bounds["low"], bounds["high"])


@dataclass(frozen=True)
class NamedCause:
    """An effect that the simulator lacks, at its place."""

    kind: str
    location: str  # for a group, all places of its kind: `body:*`, `joint:*`
    strengths: tuple[StrengthInterval, ...]  # in the mechanism's order; of a group place by place
    confidence: float  # probability, among everything that was asked
    gain: float  # [nats] log-likelihood of left-out episodes, with the cause minus without

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "location": self.location,
            "parameters": {each.name: each.to_json() for each in self.strengths},
            "confidence": self.confidence,
            "gain_nats": self.gain,
        }


@dataclass(frozen=True)
class Experiment:
    """The best experiment of a list, and how far it separates two simulators."""

    description: str
    separation: float  # root mean square difference, in expected errors of one step
    recorded: float  # the same on the recorded episodes

    @property
    def is_worth_it(self) -> bool:
        """True if it separates the two visibly, and further than the recording does."""
        return self.separation > max(_SEEN, self.recorded)

    @property
    def is_seen(self) -> bool:
        """True if anything tried or recorded separates the two visibly."""
        return max(self.separation, self.recorded) > _SEEN

    def to_json(self) -> dict[str, Any]:
        return {
            "description": self.description,
            "separation": self.separation,
            "recorded": self.recorded,
            "is_worth_it": self.is_worth_it,
        }


Dependence = Literal["motion", "position", "time", "drive", "frequency"]
_WORDS: dict[str, str] = {
    "motion": "its motion and the commands",
    "position": "its position",
    "time": "time",
    "drive": "how its drive is used",
    "frequency": "time, at {:.3g} Hz",
}
_SUSPECTS: dict[str, str] = {
    "motion": "a spring or a friction of another shape, or another drive's command",
    "position": "a ripple, or a friction that differs from place to place, beyond those tried",
    "time": "a gain that fades within an episode, or drifts over the recording",
    "drive": "a gain that depends on position or speed, or a friction that depends on the load",
    "frequency": "something that swings by itself: a part that is loose or bends, or the ground",
}


@dataclass(frozen=True)
class Rest:
    """The joint whose force would explain most of what is left, and what it would depend on."""

    location: str  # "joint:NAME"
    depends_on: Dependence
    hertz: float | None  # of a swing; None for all others

    @property
    def words(self) -> str:
        """As "a force at joint:elbow that depends on time"."""
        dependence = _WORDS[self.depends_on].format(self.hertz)
        return f"a force at {self.location} that depends on {dependence}"

    @property
    def suspects(self) -> str:
        """The finer mechanisms to look for next."""
        return _SUSPECTS[self.depends_on]


@dataclass(frozen=True)
class Residual:
    """Everything that the named causes leave, and detection limits."""

    noise: tuple[float | None, ...]  # standard deviation of each sensor, in its unit; None: nobody
    # measured it
    step: float  # [s] of the simulator that judged the data
    own_step: float  # [s] that its file has
    # what a flexible force would still gain beside the best effects, be they named or not
    unexplained_nats: float
    rest: Literal["none", "unknown"]  # unknown: that is evidence, beside the named causes
    where: Rest  # of the flexible force that gains most, even if that is chance
    moved: dict[str, tuple[float, float]]  # parameter -> fitted without and with the causes
    at_bound: tuple[str, ...]  # parameters at the edge of their bounds
    used: int  # transitions
    diverged: int  # transitions whose simulation diverged; left out
    # "kind location" -> smallest first strength that would have been seen, and its unit
    detectable: dict[str, tuple[float, str]]
    # groups of "kind location strength" that these data cannot tell apart
    confused: tuple[tuple[str, ...], ...]

    def to_json(self) -> dict[str, Any]:
        return {
            "sensor_noise": list(self.noise),
            "timestep": {"judged_with": self.step, "of_the_model": self.own_step},
            "unexplained_nats": self.unexplained_nats,
            "rest": self.rest,
            "where": None if self.rest == "none" else asdict(self.where),
            "parameters": {
                name: {"without": before, "with": after, "at_bound": name in self.at_bound}
                for name, (before, after) in self.moved.items()
            },
            "transitions": {"used": self.used, "diverged": self.diverged},
            "detectable": {
                name: {"value": size, "unit": unit}
                for name, (size, unit) in self.detectable.items()
            },
            "confused": [list(names) for names in self.confused],
        }


@dataclass(frozen=True)
class Trace:
    """A sealed episode, simulated from its first state on; (T, m) each."""

    time: Vector  # (T,) [s]
    measured: Matrix
    without: Matrix
    extended: Matrix


@dataclass(frozen=True)
class Gain:
    """Errors on the sealed episodes, without the causes and with them."""

    sse_removed: float  # share of the squared innovations
    low: float  # 95 % interval over episodes, Student's
    high: float
    # share removed of the error beyond the final noise, in which is the misfit that stays; None:
    # there is no such error
    explainable_fraction: float | None
    explainable_interval: tuple[float, float] | None  # 95 % interval of that
    # control steps -> error without and with, in expected errors of one step
    horizons: dict[int, tuple[float, float]]
    diverged: tuple[int, int]  # transitions that cannot be simulated, without and with
    trace: Trace  # for the report's figure

    def to_json(self) -> dict[str, Any]:
        return {
            "sse_removed": self.sse_removed,
            "low": self.low,
            "high": self.high,
            "explainable_fraction": self.explainable_fraction,
            "explainable_interval": self.explainable_interval and list(self.explainable_interval),
            "diverged": {"without": self.diverged[0], "with": self.diverged[1]},
            "error_by_horizon": {
                str(steps): {"without": before, "with": after}
                for steps, (before, after) in self.horizons.items()
            },
        }


@dataclass(frozen=True)
class Verdict:
    """The conclusion of a criticism with all that supports it."""

    conclusion: Conclusion
    confidence: float
    causes: tuple[NamedCause, ...]
    tied: tuple[tuple[NamedCause, ...], ...]  # equally good alternatives, cause by cause
    # for each alternative, the experiment that best separates it from the named cause
    experiments: tuple[tuple[Experiment, ...], ...]
    residual: Residual
    gain: Gain | None  # None: nothing was named that predictions would gain from
    remarks: tuple[str, ...]  # sentences on the data
    seconds: float | None  # by the clock; None in a stage's result, which must repeat exactly

    def to_json(self) -> dict[str, Any]:
        return {
            "version": VERSION,
            "verdict": self.conclusion.value,
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


def in_smaller_steps(step: float, own: float) -> str:
    """Text for a criticism in steps [s] that are smaller than the model's own, and what to do."""
    return (
        f"judged in steps of {1000 * step:.3g} ms, because the model's steps of {1000 * own:.3g} "
        "ms make larger errors than these data leave; extended.xml keeps the model's, so take "
        f"{own / step:.0f} smaller steps for each of them to get what was fitted"
    )


def sure(probability: float) -> str:
    """Text for the confidence of a verdict, which is never complete."""
    return f"{'more than 99.9' if probability > 0.999 else f'{100 * probability:.1f}'} % sure"

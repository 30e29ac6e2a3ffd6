"""What a benchmark's cores did: the share of them that computed, and what orchestration cost.

    found = utilisation(timings)
    found.useful          # 0.93: CPU seconds of computing per core second that could be had

Looked at are the moments when at least as many stages were asked for and not finished as there
are cores: only then could all cores have been busy.
"""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """When one stage was computed, in seconds since the epoch, and what its process did."""

    asked: float  # for the first time, by any run
    placed: float  # on a core
    began: float  # in its process
    ended: float
    cpu: float  # CPU seconds of the process from `began` to `ended`
    preparing: float  # of these seconds, those of imports and compilations
    is_first: bool  # of its process, whose start-up lies between `placed` and `began`
    cores: int  # of the cluster


@dataclass(frozen=True)
class Utilisation:
    """Core seconds of a window, by what they were spent on; their sum is cores x seconds."""

    cores: int
    seconds: float  # of the window
    computing: float  # CPU seconds of stages
    starting: float  # of processes
    preparing: float  # imports and compilations inside of stages
    waiting: float  # within a stage, without a CPU: other processes had it, or the disk
    orchestration: float  # a core was free, or its stage on the way to it

    @property
    def useful(self) -> float:
        """Share of the core seconds that computed, start-up and preparation left out."""
        return self.computing / (self.computing + self.waiting + self.orchestration)

    @property
    def overhead(self) -> float:
        """Share of all core seconds that went to orchestration."""
        return self.orchestration / (self.cores * self.seconds)


def utilisation(timings: Sequence[Timing]) -> Utilisation | None:
    """None where there was never enough to do for all cores."""
    cores = max((timing.cores for timing in timings), default=1)
    window = _busy(timings, cores)
    total = sum(end - start for start, end in window)
    if total == 0:
        return None
    computing = starting = preparing = waiting = dispatching = 0.0
    for timing in timings:
        on_the_way = _overlap(window, timing.placed, timing.began)
        if timing.is_first:
            starting += on_the_way
        else:
            dispatching += on_the_way
        inside = _overlap(window, timing.began, timing.ended)
        seconds = timing.ended - timing.began
        if seconds > 0:
            share = inside / seconds
            preparing += share * timing.preparing
            computing += share * max(0.0, timing.cpu - timing.preparing)
            waiting += inside - share * max(timing.cpu, timing.preparing)
    placed = starting + dispatching + computing + preparing + waiting
    free = cores * total - placed
    return Utilisation(cores, total, computing, starting, preparing, waiting, dispatching + free)


def _busy(timings: Sequence[Timing], cores: int) -> list[tuple[float, float]]:
    """The spans in which at least `cores` stages were asked for and not finished."""
    changes = sorted([(t.asked, 1) for t in timings] + [(t.ended, -1) for t in timings])
    spans: list[tuple[float, float]] = []
    present, since = 0, 0.0
    for moment, change in changes:
        if present < cores <= present + change:
            since = moment
        elif present + change < cores <= present:
            spans.append((since, moment))
        present += change
    return spans


def _overlap(spans: Sequence[tuple[float, float]], start: float, end: float) -> float:
    return sum(max(0.0, min(end, last) - max(start, first)) for first, last in spans)

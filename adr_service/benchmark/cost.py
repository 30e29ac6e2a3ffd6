"""Executions of stages, and how well a cluster's cores were used.

    used = utilisation(executions)
    used.useful          # 0.93: CPU seconds of computing per core second that could be had

The window is the time in which the unfinished stages were at least as many as the cores: only then
could all cores have been busy. Nodes may come and go, so the number of cores at a moment is the one
that the last placed stage has noted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import computed_field

from adr_service.json_values import Wire

USES = {  # of core seconds, for people
    "computing": "CPU time of stages",
    "preparing": "CPU time of stages for imports and compilations",
    "waiting": "within stages, without a CPU: other processes had it, or the disk",
    "starting": "new processes",
    "orchestration": "a core was free, or its stage was on the way to it",
}


@dataclass(frozen=True, kw_only=True)
class Execution:
    """Origin and cost of a stage's result. Times are in seconds since the epoch.

    None stands for a measurement that does not exist: a robot's episode takes no core.
    """

    attempt: int  # 1, 2, …
    started_by: str  # id of the run
    asked: float  # when any run first asked for the stage; a robot's episode: published
    placed: float  # when it got a core; a robot's episode: claimed
    began: float  # when its process began to compute
    ended: float
    cpu: float | None = None  # CPU seconds of the process from `began` to `ended`
    preparing: float | None = None  # seconds of these for imports and compilations
    is_first: bool | None = None  # the process was new, and started between `placed` and `began`
    cores: int | None = None  # of the cluster
    provenance: dict[str, Any] = field(default_factory=dict[str, Any])  # package versions, CPU

    @property
    def seconds(self) -> float:
        """Seconds from `began` to `ended`."""
        return self.ended - self.began

    @property
    def computing(self) -> float:
        """CPU seconds without imports and compilations; zero where these took longer by JAX's own
        clock, which also counts waiting for a core."""
        return max(0.0, (self.cpu or 0.0) - (self.preparing or 0.0))

    @property
    def is_measured(self) -> bool:
        """True if a process of the cluster measured itself."""
        return self.cpu is not None


class Utilisation(Wire):
    """Core seconds of a window by their use, which add up to all that could be had.

    They computed, started processes, prepared stages (imports and compilations), waited within
    stages for a CPU, or went to orchestration. See the glossary.
    """

    cores: int  # most at a time
    seconds: float  # of the window
    computing: float
    starting: float
    preparing: float
    waiting: float
    orchestration: float

    @computed_field
    @property
    def useful(self) -> float:
        """Share of the core seconds that computed, start-up and preparation left out."""
        had = self.computing + self.waiting + self.orchestration
        return self.computing / had if had else 0.0

    @computed_field
    @property
    def overhead(self) -> float:
        """Share of all core seconds that went to orchestration."""
        return self.orchestration / sum(getattr(self, use) for use in USES)


def utilisation(executions: Sequence[Execution]) -> Utilisation | None:
    """Return the use of the cores; None if there was never enough work for all of them."""
    measured = [execution for execution in executions if execution.is_measured]
    window = _window(measured)
    if not window:
        return None
    # a core that is free, or waits for its stage to begin, is left over: orchestration
    uses = {"starting": 0.0, "computing": 0.0, "preparing": 0.0, "waiting": 0.0}
    for execution in measured:
        for use, seconds in _uses(execution, window).items():
            uses[use] += seconds
    had = sum(cores * (end - start) for start, end, cores in window)
    return Utilisation(
        cores=max(cores for _, _, cores in window),
        seconds=sum(end - start for start, end, _ in window),
        orchestration=had - sum(uses.values()),
        **uses,
    )


_Span = tuple[float, float, int]  # start, end, cores


def _uses(execution: Execution, window: Sequence[_Span]) -> dict[str, float]:
    """Seconds of the window that one execution took of a core, by their use."""
    uses: dict[str, float] = {}
    if execution.is_first:
        uses["starting"] = _overlap(window, execution.placed, execution.began)
    if execution.seconds > 0:
        cpu, preparing = execution.cpu or 0.0, execution.preparing or 0.0
        inside = _overlap(window, execution.began, execution.ended)
        share = inside / execution.seconds
        uses["preparing"] = share * preparing
        uses["computing"] = share * execution.computing
        uses["waiting"] = inside - share * max(cpu, preparing)
    return uses


def _window(executions: Sequence[Execution]) -> list[_Span]:
    """Spans of time in which at least as many stages as cores were asked for and not finished."""
    placed = sorted((e.placed, 0, e.cores or 1) for e in executions)
    changes = [(e.asked, 1, None) for e in executions] + [(e.ended, -1, None) for e in executions]
    spans: list[_Span] = []
    present, since, cores = 0, 0.0, placed[0][2] if placed else 1
    for moment, change, seen in sorted([*changes, *placed], key=lambda each: each[:2]):
        was_busy, is_busy = present >= cores, present + change >= (seen or cores)
        has_changed = is_busy != was_busy or seen not in (None, cores)
        if was_busy and has_changed and moment > since:
            spans.append((since, moment, cores))
        if has_changed:
            since = moment
        present, cores = present + change, seen or cores
    return spans


def _overlap(spans: Sequence[_Span], start: float, end: float) -> float:
    return sum(max(0.0, min(end, last) - max(start, first)) for first, last, _ in spans)

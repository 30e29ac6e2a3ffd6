"""The cost of runs before they run: their own programs, over stages that price instead of compute.

    plan(list(spec.runs()), cores=4).hours

Every run's program is the one that will run. Each stage answers with its stand-in, so that runs
share in the plan what they will share, and waits until a core would have computed it: the plan
knows how many trainings can run at once.
"""

import heapq
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from adr_service.errors import AdrError, InvalidInput
from adr_service.events import RunEvent
from adr_service.programs import Program, run
from adr_service.randomness import stream
from adr_service.simulation.batch import Simulations
from adr_service.simulation.rollout import random_actions
from adr_service.specs import AnyRun, RunSpec
from adr_service.stages.base import PRIORITY, CoreSpeed, Cost, R, Result, Role, Stage, StageResult
from adr_service.tasks.catalogue import get_task, variants_of

Find = Callable[[str], StageResult | None]  # a stored result, by digest
_MEASURED_S = 0.05  # of simulating, to know the speed of a task


@dataclass(frozen=True)
class Plan:
    """An estimate of the cost of runs.

    Trainings may stop earlier, at the reward threshold, which nobody knows before.
    """

    runs: int
    stored: int  # stages that have a result already, and cost nothing
    trainings: int  # distinct; equal ones are shared between runs
    environment_steps: int
    target_transitions: int  # distinct, at most
    core_hours: float
    cores: int
    hours: float | None  # on these cores, with waiting for each other; None without cores
    policies_mb: float
    basis: str = (
        "estimate, if every training uses all its steps, without the start of processes and "
        "compilation; simulation speed measured on this machine a moment ago, gradient steps as "
        "measured on one server core"
    )


class MeasuredSpeed:
    """The speed of one core of this machine, measured."""

    def __init__(self) -> None:
        self._rates: dict[str, float] = {}

    def steps_per_second(self, task: str) -> float:
        """Control steps of one core's time, whatever else it does."""
        if task not in self._rates:
            self._rates[task] = _step_rate(task)
        return self._rates[task]


def plan(
    runs: Sequence[AnyRun],
    cores: int,
    recording: Callable[[AnyRun], bytes | None] | None = None,
    speed: CoreSpeed | None = None,
    find: Find = lambda digest: None,
) -> Plan:
    """The cost of `runs` on `cores` cores, by default of this machine's speed.

    `recording` gives the dataset that a run names, and `find` the stored results of stages, which
    cost nothing.
    """
    costs = _Schedule(speed or MeasuredSpeed(), max(cores, 1), find)
    for number, spec in enumerate(runs):
        content = None if recording is None else recording(spec)
        named = spec.method.name if isinstance(spec, RunSpec) else spec.kind
        costs.start(_Planned(named, run(spec, _PricedStages(f"run {number}"), content)))
    seconds = costs.finish()
    distinct = list(costs.priced.values())
    core_seconds = sum(job.cost.seconds for job in distinct if job.role != "robot")
    return Plan(
        runs=len(runs),
        stored=costs.stored,
        trainings=sum(job.role == "trainer" for job in distinct),
        environment_steps=sum(job.cost.environment_steps for job in distinct),
        target_transitions=sum(job.cost.target_transitions for job in distinct),
        core_hours=core_seconds / 3600,
        cores=cores,
        hours=seconds / 3600 if cores else None,
        policies_mb=sum(job.cost.policy_bytes for job in distinct) / 1e6,
    )


@dataclass(frozen=True)
class _Request:
    """A program's request for results, yielded in place of an event."""

    stages: Sequence[Stage[Any]]


class _PricedStages:
    """Stages of a plan: the schedule gets each request, and sends the results."""

    def __init__(self, run_id: str):
        self.run_id = run_id

    def all(self, stages: Sequence[Stage[R]]) -> Generator[RunEvent, None, list[R]]:
        # a request is no event, and is sent its answer: the schedule alone iterates such a program
        return cast(list[R], (yield cast(RunEvent, _Request(stages))))

    def run(self, stage: Stage[R]) -> Generator[RunEvent, None, R]:
        return (yield from self.all([stage]))[0]


@dataclass(frozen=True, eq=False)
class _Planned:
    """A run's program, with the name of its method."""

    name: str
    program: Program

    def send(self, answers: list[Result] | None) -> Any:
        """The program's next event or request; None at its end.

        Raises InvalidInput where it breaks, as a user's method may, also by a request that is no
        JSON.
        """
        try:
            event: Any = self.program.send(cast(None, answers))
            if isinstance(event, _Request):
                _ = [stage.digest for stage in event.stages]
            return event
        except StopIteration:
            return None
        except AdrError:
            raise
        except (Exception, SystemExit) as error:
            raise InvalidInput(
                f"a run of {self.name} cannot be planned: its program raises {error!r}"
            ) from error


@dataclass(eq=False)
class _Job:
    """A stage that some programs wait for, once for all of them."""

    role: Role
    cost: Cost
    answer: Result  # a stand-in, or the stored result
    is_done: bool = False
    waiting: "list[_Waiting]" = field(default_factory=list)


@dataclass(eq=False)
class _Waiting:
    """A program that goes on when all stages of its request are done."""

    run: _Planned
    jobs: list[_Job]


class _Schedule:
    """Cores that compute stages one after the other, as the dispatcher would place them.

    Each task has one robot, which runs one episode after the other.
    """

    def __init__(self, speed: CoreSpeed, cores: int, find: Find):
        self._speed, self._free, self._find = speed, cores, find
        self._now = 0.0
        self._ready: list[tuple[int, int, str]] = []  # priority, number, digest
        self._running: list[tuple[float, int, str]] = []  # end, number, digest
        self._robots: dict[str, float] = {}  # by task, when its robot is free
        self.priced: dict[str, _Job] = {}
        self._stored: dict[str, _Job] = {}

    @property
    def stored(self) -> int:
        """The number of stages with a stored result."""
        return len(self._stored)

    def start(self, planned: _Planned) -> None:
        """Let a program run until it waits for a stage."""
        self._go_on(planned, None)

    def finish(self) -> float:
        """The time [s] at which the last program ends."""
        while self._ready or self._running:
            while self._ready and self._free:
                _, number, digest = heapq.heappop(self._ready)
                self._free -= 1
                self._begin(number, digest, self._now)
            self._now, _, digest = heapq.heappop(self._running)
            job = self.priced[digest]
            self._free += job.role != "robot"
            self._complete(job)
        return self._now

    def _go_on(self, planned: _Planned, answers: list[Result] | None) -> None:
        """Iterate a program to its next request that has to wait, or to its end."""
        while (event := planned.send(answers)) is not None:
            answers = None
            if isinstance(event, _Request):
                jobs = [self._job(stage) for stage in event.stages]
                if not all(job.is_done for job in jobs):
                    self._wait(planned, jobs)
                    return
                answers = [job.answer for job in jobs]

    def _wait(self, planned: _Planned, jobs: list[_Job]) -> None:
        entry = _Waiting(planned, jobs)
        for job in jobs:
            if not job.is_done and entry not in job.waiting:
                job.waiting.append(entry)

    def _job(self, stage: Stage[Any]) -> _Job:
        job = self.priced.get(stage.digest) or self._stored.get(stage.digest)
        if job is None and (stored := self._find(stage.digest)) is not None:
            answer = stage.read(stored)
            job = self._stored[stage.digest] = _Job(stage.role, Cost(0.0), answer, is_done=True)
        if job is None:
            number = len(self.priced)
            job = _Job(stage.role, stage.cost(self._speed), stage.stand_in())
            self.priced[stage.digest] = job
            if stage.role == "robot":  # which needs no core
                free = max(self._now, self._robots.get(stage.task, 0.0))
                self._robots[stage.task] = self._begin(number, stage.digest, free)
            else:
                heapq.heappush(self._ready, (PRIORITY[stage.role], number, stage.digest))
        return job

    def _begin(self, number: int, digest: str, at: float) -> float:
        """Begin a stage; the time [s] at which it ends."""
        end = at + self.priced[digest].cost.seconds
        heapq.heappush(self._running, (end, number, digest))
        return end

    def _complete(self, job: _Job) -> None:
        job.is_done = True
        for entry in job.waiting:
            if all(each.is_done for each in entry.jobs):
                self._go_on(entry.run, [each.answer for each in entry.jobs])
        job.waiting.clear()


def _step_rate(task_name: str) -> float:
    task = get_task(task_name)
    source = next(iter(variants_of(task.name).values())).source
    simulations, rng = Simulations(task, source, 12), stream("step rate", task.name)
    simulations.set_dynamics(np.tile((source.space.low + source.space.high) / 2, (12, 1)))
    simulations.set_state(task.initial(12, rng))
    act, unseen = random_actions(task, rng), np.empty((12, 0))
    steps, started = 0, time.thread_time()
    while (elapsed := time.thread_time() - started) < _MEASURED_S:
        simulations.step(act(unseen))
        steps += 12
    return steps / elapsed

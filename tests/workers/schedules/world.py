"""A schedule: runs, robots and a service that dies, until all runs have ended and nothing is left.

figures = World(rng, MemoryLedger()).play()     # Violation if something must never be, and is
"""

import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from adr_service.errors import FailureCode, StageFailed
from adr_service.events import RunState
from adr_service.stages.base import AnyStage, StageResult
from db.visits import LeaseLost
from tests.stages.examples import criticism, episode, evaluation, rollout, training
from tests.workers.schedules.clock import Clock
from tests.workers.schedules.faults import Faults, ServiceDied, Violation
from tests.workers.schedules.ledgers import Claim, Ledger
from tests.workers.schedules.simulated_ray import SimulatedCluster, SimulatedRay, result_of
from tests.workers.schedules.witness import Witness
from workers.cluster import ClusterUnavailable, RayOptions
from workers.dispatcher import Dispatcher

_FAULTS_S = 200.0  # after which no fault comes any more
_END_S = 3000.0  # by which every run has ended: nine silences, and the stages themselves
_UNWANTED_S = 60.0  # by which a stage that no run wants has left its core
_ROBOT_LEASE_S = 30.0
_LOSSES = {
    *("process dies", "process hangs", "process hangs before its first sign"),
    *("process pauses and answers late", "idle process dies", "node dies", "Ray dies"),
}
_LIVE = (RunState.QUEUED, RunState.RUNNING)
_CAUSES = {  # of failures, and the fault that each needs
    FailureCode.INVALID_INPUT: "stage fails",
    FailureCode.UNKNOWN_NAME: "stage cannot be unpacked",
    FailureCode.TARGET_FAILED: "robot gives up",
    FailureCode.NOT_STORED: "database refuses a result",
}


@dataclass
class Figures:
    """Counts of one schedule, or of many."""

    schedules: int = 0
    on_database: int = 0  # of these
    rounds: int = 0
    stages: int = 0  # stored
    batches: int = 0  # transactions that stored several of them
    runs: int = 0
    faults: Counter[str] = field(default_factory=Counter[str])

    def __add__(self, other: "Figures") -> "Figures":
        return Figures(
            self.schedules + other.schedules,
            self.on_database + other.on_database,
            self.rounds + other.rounds,
            self.stages + other.stages,
            self.batches + other.batches,
            self.runs + other.runs,
            self.faults + other.faults,
        )

    def __str__(self) -> str:
        faults = ", ".join(f"{name} {count}" for name, count in sorted(self.faults.items()))
        counts = f"runs {self.runs}, rounds {self.rounds}, stages committed {self.stages}"
        counts = f"{counts}, several at once {self.batches} times"
        schedules = f"schedules {self.schedules} ({self.on_database} on SQLite)"
        return f"{schedules}, {counts}; faults {self.faults.total()}: {faults}"


@dataclass
class Run:
    """A run: it asks for a round of stages at a time, and waits for all of them."""

    id: str
    rounds: list[list[AnyStage]]
    state: RunState = RunState.QUEUED
    submission: int = 1
    is_cancelled: bool = False
    has_news: bool = True  # something to go on with
    at: int = 0  # the round
    waits: list[tuple[AnyStage, Future[StageResult]]] = field(
        default_factory=list[tuple[AnyStage, "Future[StageResult]"]]
    )


@cache
def _shared_stages() -> list[AnyStage]:
    """Stages that several runs ask for."""
    makers: tuple[Callable[[int], AnyStage], ...] = (training, criticism, evaluation, rollout)
    return [make(number) for make in makers for number in range(3)]


_episode = cache(episode)


class _Impatient(threading.Event):
    """Waits for nobody: a dispatcher that looks for Ray again stands still meanwhile."""

    def wait(self, timeout: float | None = None) -> bool:
        return self.is_set()


class World:
    """One schedule. All its random numbers come from `rng`."""

    def __init__(self, rng: np.random.Generator, ledger: Ledger):
        self.rng, self.ledger = rng, ledger
        self.clock, self.faults = Clock(), Faults(rng)
        self.ray = SimulatedRay(self.clock, self.faults, is_local=bool(rng.random() < 0.5))
        self.witness = Witness(ledger, self.ray, self.faults)
        self.runs: list[Run] = []
        self.figures = Figures(schedules=1)
        self._unwanted: dict[str, float] = {}  # running stages that no run wants, since
        self._accepted: dict[str, str] = {}  # leases of robots' episodes, by digest
        self._to_come = 0  # submissions of runs, and answers of robots

    def play(self) -> Figures:
        """Go through the schedule, and check what must hold."""
        with self.ray.in_place():
            self.ray.begin()
            self._start_service()
            self._draw()
            while not self._is_over():
                self._round()
                self.clock.advance()
            self._audit()
        self.figures.stages, self.figures.batches = self.witness.commits, self.witness.batches
        self.figures.runs = len(self.runs)
        self.figures.faults = self.faults.injected
        return self.figures

    # the service

    def _start_service(self) -> None:
        """Start it on an empty Ray; unfinished runs begin anew."""
        options = RayOptions(address="local" if self.ray.is_local else "auto", keep_idle_s=20.0)
        self.dispatcher = Dispatcher(options, self.witness, lambda _: SimulatedCluster(self.ray))
        self.dispatcher._stop = _Impatient()
        self.dispatcher._start_ray()
        self._unwanted.clear()
        self.ledger.forget_unclaimed()
        for run in self.runs:
            if run.state in _LIVE:
                run.at, run.waits, run.has_news = 0, [], True

    def _kill_service(self) -> None:
        self.ray.end()
        self._start_service()

    def _round(self) -> None:
        self.figures.rounds += 1
        try:
            for run in self.runs:
                if run.has_news and run.state in _LIVE:
                    self._go_on(run)
            self.dispatcher._step()
        except (ServiceDied, ClusterUnavailable):
            self._kill_service()
        self._check()

    # runs

    def _go_on(self, run: Run) -> None:
        """Go on with a run as the orchestrator and `RayStages` would, without waiting."""
        run.has_news = False
        if run.is_cancelled:
            self._end(run, RunState.CANCELLED)
            return
        if run.state == RunState.QUEUED:
            self.ledger.begin_run(run.id, run.submission)
            run.state = RunState.RUNNING
        if not run.waits:
            if run.at == len(run.rounds):
                self._end(run, RunState.SUCCEEDED)
                return
            for stage in run.rounds[run.at]:
                future = self.dispatcher.submit(stage, run.id)
                future.add_done_callback(lambda _: self._tell(run))
                run.waits.append((stage, future))
            return
        for stage, future in run.waits:
            if future.done() and (error := future.exception()) is not None:
                self._check_failure(stage, error)
                self._end(run, RunState.FAILED)
                return
        if all(future.done() for _, future in run.waits):
            for stage, future in run.waits:
                if future.result() != result_of(stage):
                    raise Violation(f"a run was given another result for {stage.kind}")
                if stage.digest not in self.witness.stored:
                    raise Violation(f"a run was given a result of {stage.kind} that is not stored")
            run.at, run.waits, run.has_news = run.at + 1, [], True

    def _tell(self, run: Run) -> None:
        run.has_news = True

    def _end(self, run: Run, state: RunState) -> None:
        self.dispatcher.withdraw(run.id)
        self.ledger.end_run(run.id, run.submission, state)
        run.state, run.waits = state, []
        is_wanted = state != RunState.SUCCEEDED and self.rng.random() < 0.7
        if is_wanted and run.submission < 3:
            self._to_come += 1
            most = 10.0 if self.rng.random() < 0.5 else 100.0
            self.clock.after(most * self.rng.random(), lambda: self._resume(run))

    def _resume(self, run: Run) -> None:
        self._to_come -= 1
        self.ledger.resubmit(run.id)
        run.state, run.at, run.is_cancelled, run.has_news = RunState.QUEUED, 0, False, True
        run.submission += 1

    def _check_failure(self, stage: AnyStage, error: BaseException) -> None:
        """A failure must have the fault that it names."""
        cause = error.cause if isinstance(error, StageFailed) else None
        lost = sum(n for name, n in self.faults.injected.items() if name in _LOSSES)
        fits = (
            lost >= 1
            if cause == FailureCode.WORKER_LOST
            else self.faults.injected[_CAUSES.get(cause, "")] > 0
        )
        if cause == FailureCode.NOT_STORED:
            fits = stage.digest in self.witness.refused
        if not fits:
            raise Violation(f"{stage.kind} failed without a fault: {error!r}")

    # what happens

    def _draw(self) -> None:
        """Draw what happens when: runs, faults of nodes, of the database and of the service."""
        for _ in range(1 + int(4 * self.rng.random())):
            self._to_come += 1
            self.clock.after(30.0 * self.rng.random(), self._submit)
        self._sometimes(3, "node dies", self._lose_node)
        self._sometimes(2, "Ray dies", self._kill_ray)
        self._sometimes(2, "board dies", self.ray.end_board)
        self._sometimes(2, "board hangs", self.ray.hang_board)
        self._sometimes(3, "database goes away", self._lose_database)
        self._sometimes(2, "service dies between rounds", self._kill_service)
        self.clock.after(2.0, self._let_robots_work)
        self.clock.after(_FAULTS_S, self._end_faults)

    def _sometimes(self, times: int, fault: str, action: Callable[[], None]) -> None:
        for _ in range(times):
            if self.faults.happens(fault):
                self.clock.after(90.0 * self.rng.random(), action)

    def _end_faults(self) -> None:
        self.faults.are_over = True

    def _submit(self) -> None:
        self._to_come -= 1
        run_id = self.ledger.submit()
        shared = _shared_stages()
        rounds: list[list[AnyStage]] = []
        for number in range(1 + int(3 * self.rng.random())):
            chosen = self.rng.integers(len(shared), size=1 + int(4 * self.rng.random()))
            rounds.append([shared[index] for index in chosen.tolist()])
            if self.rng.random() < 0.2:
                rounds[-1].append(_episode(run_id, number))
        run = Run(run_id, rounds)
        self.runs.append(run)
        if self.faults.happens("run is cancelled"):
            self.clock.after(60.0 * self.rng.random(), lambda: self._cancel(run))

    def _cancel(self, run: Run) -> None:
        run.is_cancelled = run.has_news = run.state in _LIVE

    def _lose_node(self) -> None:
        """Let a node go, and another come; a local cluster has one, which stays."""
        seen = [node for node in self.ray.nodes.values() if node.is_reached]
        if self.ray.is_local or not seen:
            return
        node = seen[int(len(seen) * self.rng.random())]
        self.ray.lose(node, self.faults.happens("node is cut off and computes on"))
        self.clock.after(40.0 * self.rng.random(), self.ray.add_node)

    def _kill_ray(self) -> None:
        self.ray.is_dead = True

    def _lose_database(self) -> None:
        self.witness.is_away = True
        self.clock.after(15.0 * self.rng.random(), self._return_database)

    def _return_database(self) -> None:
        self.witness.is_away = False

    # robots

    def _let_robots_work(self) -> None:
        """Claim an episode, if there is one, and look again later."""
        self.clock.after(5.0 + 10.0 * self.rng.random(), self._let_robots_work)
        if self.witness.is_away:
            return
        claim = self.ledger.claim("robot", self.clock.now, _ROBOT_LEASE_S)
        if claim is None:
            return
        late = _ROBOT_LEASE_S if self.faults.happens("robot answers late") else 0.0
        self._answer_in(late + 20.0 * self.rng.random(), claim)
        if self.faults.happens("robot answers twice"):
            self._answer_in(late + 60.0 * self.rng.random(), claim)

    def _answer_in(self, seconds: float, claim: Claim) -> None:
        self._to_come += 1
        gives_up = self.faults.happens("robot gives up")

        def answer() -> None:
            self._to_come -= 1
            if self.witness.is_away:
                self._answer_in(2.0, claim)
                return
            with suppress(LeaseLost):  # another robot has it, or its run has ended
                self._refuse(claim) if gives_up else self._complete(claim)

        self.clock.after(seconds, answer)

    def _complete(self, claim: Claim) -> None:
        asked = (stage for run in self.runs for stages in run.rounds for stage in stages)
        stage = next(stage for stage in asked if stage.digest == claim.digest)
        self.ledger.complete(claim, stage, result_of(stage), self.clock.now)
        if self._accepted.setdefault(claim.digest, claim.lease) != claim.lease:
            raise Violation("an episode is accepted from two robots")
        self.witness.commits += claim.digest not in self.witness.stored
        self.witness.stored[claim.digest] = None
        self.dispatcher.arrived(claim.digest)

    def _refuse(self, claim: Claim) -> None:
        self.ledger.refuse(claim)
        self.dispatcher.refused(claim.digest, "as the schedule has it")

    # what must hold

    def _is_over(self) -> bool:
        if self.clock.now > _END_S:
            waiting = [run.id for run in self.runs if run.state in _LIVE]
            raise Violation(f"not everything has ended: runs {waiting}, and {self._left()}")
        if self._to_come or any(run.state in _LIVE for run in self.runs):
            return False
        return not self._left()

    def _left(self) -> list[str]:
        """The work that the dispatcher still has."""
        jobs = self.dispatcher._jobs
        left = [job.stage.kind for job in jobs._jobs.values()]
        return [*left, *("a retry" for _ in jobs.retries._actions)]

    def _check(self) -> None:
        """Raise Violation for anything that must not be after a round."""
        now, jobs = self.clock.now, self.dispatcher._jobs
        self._unwanted = {digest: self._unwanted.get(digest, now) for digest in jobs.unwanted()}
        if any(now - since > _UNWANTED_S for since in self._unwanted.values()):
            raise Violation("a stage that no run wants keeps its core")

    def _audit(self) -> None:
        """Raise Violation for anything that must not be at the end."""
        if claimed := self.ledger.claimed():
            raise Violation(f"{len(claimed)} visits are claimed by nobody")
        if self.ledger.stored(list(self.witness.asked)) != self.witness.stored.keys():
            raise Violation("a stored result was lost")
        for run in self.runs:
            finished = self.ledger.finished(run.id)
            if len(finished) != len(set(finished)):
                raise Violation("a stage has finished twice on a run's record")
            wanted = {stage.digest for stages in run.rounds for stage in stages}
            if run.state == RunState.SUCCEEDED and set(finished) != wanted:
                raise Violation("a run's record lacks a stage that it was given")
        self._audit_cost()

    def _audit_cost(self) -> None:
        """Each stored result has the cost of the one computation that it is from."""
        computed = {(attempt, began): digest for digest, attempt, began in self.ray.computed}
        executions = self.ledger.executions()
        origins = [(execution.attempt, execution.began) for execution in executions]
        digests = [computed.get(origin) for origin in origins]
        robots = sum(origin is None for origin in self.witness.stored.values())
        if len(set(digests)) != len(self.witness.stored) - robots or None in digests:
            raise Violation("a cost is attributed twice, or never")
        for execution, digest in zip(executions, digests, strict=True):
            if execution.started_by not in self.witness.asked[str(digest)]:
                raise Violation("a cost is attributed to a run that did not ask")
            if not execution.asked <= execution.placed <= execution.began <= execution.ended:
                raise Violation("an execution began before it was placed or asked for")

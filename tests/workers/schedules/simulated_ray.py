"""A simulated Ray: nodes, processes that end, die or hang, and the board of signs of life."""

import itertools
import time
from collections.abc import Iterator, Set
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import ray
from ray.exceptions import ActorDiedError, RayTaskError

from adr_service.benchmark.cost import Execution
from adr_service.errors import FailureCode
from adr_service.progress import Checkpoint
from adr_service.stages.base import AnyStage, StageResult
from tests.workers.schedules.clock import Clock, epoch
from tests.workers.schedules.faults import Faults, Violation
from workers.actors import Failed, Finished, Stopped
from workers.cluster import ClusterUnavailable
from workers.heartbeats import Board, SignOfLife

_HEAD = f"{0:056x}"  # as Ray writes the ids of nodes
_LOST = ActorDiedError()
_SECONDS = (0.01, 0.5, 5.0, 50.0, 500.0)  # that a stage takes at most, the first most often


_results: dict[str, StageResult] = {}  # by digest; of stages that have no hash


def result_of(stage: AnyStage) -> StageResult:
    """The only right result of a stage."""
    if stage.digest not in _results:
        _results[stage.digest] = stage.stand_in().to_stored()
    return _results[stage.digest]


class Ref:
    """The answer to a call, once there is one."""

    def __init__(self) -> None:
        self.is_done = False
        self.answer: Any = None

    def resolve(self, answer: Any) -> None:
        """Answer the call with a value or an error; the first answer counts."""
        if not self.is_done:
            self.is_done, self.answer = True, answer


@dataclass
class Node:
    """A machine. Ray notices its death late."""

    id: str
    cpus: int
    is_up: bool = True
    is_seen: bool = True  # alive, as Ray sees it
    is_reached: bool = True  # else its processes compute on, and nobody hears of it
    processes: list["Process"] = field(default_factory=list["Process"])


@dataclass
class Call:
    """A stage that a process computes."""

    stage: AnyStage
    placed: Execution
    began: float
    first_sign: float
    ref: Ref = field(default_factory=Ref)
    signs_again: float = 0.0  # it pauses until then
    is_stopping: bool = False
    computes_on: bool = False  # for as long as no run wants the result


class Process:
    """A process of a `StageActor`, in place of its handle as well."""

    def __init__(self, world: "SimulatedRay", node: Node | None):
        self._world, self.node = world, node
        self.is_alive = node is not None and node.is_up
        self.call: Call | None = None
        self._imported = world.clock.now + float(world.faults.rng.uniform(0.1, 6.0))
        self.compute = SimpleNamespace(remote=self._compute)
        if node is not None:
            node.processes.append(self)

    def _compute(self, stage: AnyStage, placed: Execution, board: Any) -> Ref:
        world, now = self._world, self._world.clock.now
        world.touch()
        if self.call is not None:
            raise Violation(f"a process computes {self.call.stage.kind}, and is given another")
        if not self.is_alive or world.faults.happens("idle process dies"):
            self.is_alive = False
            ref = Ref()
            self._notice(ref)
            return ref
        assert self.node is not None
        if sum(p.call is not None for p in self.node.processes) >= self.node.cpus:
            raise Violation(f"a node of {self.node.cpus} cores has one more stage")
        # each computation at a moment of its own, which tells it apart
        began = max(now, self._imported) + 0.01 * world.faults.rng.random()
        self.call = call = Call(stage, placed, began, began + world.faults.rng.random())
        self._decide(call)
        return call.ref

    def _decide(self, call: Call) -> None:
        """Draw how the call ends."""
        world, happens, rng = self._world, self._world.faults.happens, self._world.faults.rng
        seconds = _SECONDS[int(len(_SECONDS) * rng.random() ** 1.5)] * rng.random()
        ends = call.began - world.clock.now + seconds
        if happens("process dies"):
            world.clock.after(ends, lambda: self._die(call))
        elif happens("process hangs before its first sign"):
            call.first_sign = float("inf")
        elif happens("process hangs"):
            call.signs_again = float("inf")
        elif happens("process pauses and answers late"):
            call.signs_again = call.began + 150.0 * rng.random()
            world.clock.after(ends + 150.0 * rng.random(), lambda: self._end(call, self._finished))
        elif happens("stage fails"):
            failed = Failed(FailureCode.INVALID_INPUT, "as the schedule has it")
            world.clock.after(ends, lambda: self._end(call, failed))
        elif happens("stage cannot be unpacked"):
            trace = "ModuleNotFoundError: as the schedule has it"
            error = RayTaskError("compute", trace, ImportError(), "title", 1, "127.0.0.1")
            world.clock.after(ends, lambda: self._end(call, error))
        else:
            world.clock.after(ends, lambda: self._end(call, self._finished))

    def _finished(self) -> Finished:
        assert self.call is not None
        call, (began, now) = self.call, map(epoch, (self.call.began, self._world.clock.now))
        measured = {"cpu": 0.5, "preparing": 0.1, "is_first": False, "provenance": {}}
        execution = replace(call.placed, began=began, ended=now, **measured)
        self._world.computed.append((call.stage.digest, execution.attempt, began))
        return Finished(result_of(call.stage), execution)

    def _end(self, call: Call, answer: Any) -> None:
        """Answer a call, if the process lives and is heard."""
        is_heard = self.is_alive and self.node is not None and self.node.is_reached
        if is_heard and self.call is call and not call.computes_on:
            answered = answer() if callable(answer) else answer
            self.call = None
            call.ref.resolve(answered)

    def _die(self, call: Call) -> None:
        if self.call is call:
            self.die()

    def die(self) -> None:
        """Die; Ray notices a moment later."""
        if (call := self.vanish()) is not None:
            self._notice(call.ref)

    def vanish(self) -> Call | None:
        """Die unnoticed; what was computed, if anything."""
        if self.is_alive and self.node is not None:
            self.node.processes.remove(self)
        call, self.call, self.is_alive = self.call, None, False
        return call

    def _notice(self, ref: Ref) -> None:
        self._world.clock.after(self._world.faults.rng.random(), lambda: ref.resolve(_LOST))

    def sign(self, board: Board) -> None:
        """Report to the board, unless nothing goes on or it pauses; stop if the board says so."""
        call, now = self.call, self._world.clock.now
        if call is None or now < max(call.first_sign, call.signs_again):
            return
        has_more = call.stage.role == "trainer" and self._world.faults.rng.random() < 0.1
        checkpoint = Checkpoint(int(now), b"so far", ()) if has_more else None
        attempt = (call.stage.digest, call.placed.attempt)
        unwanted = board.report(SignOfLife(*attempt, 0.5, {}, "actor", 1, checkpoint))
        if call.computes_on and not unwanted:
            call.computes_on = False
            self._end(call, self._finished)  # it was wanted again in time
        elif unwanted and not call.is_stopping:
            call.is_stopping = True
            call.computes_on = self._world.faults.happens("stage does not ask whether to stop")
            if call.computes_on:
                return
            stops = 5.0 * self._world.faults.rng.random()
            self._world.clock.after(stops, lambda: self._end(call, Stopped()))


class BoardHandle:
    """The board's actor: the real `Board`, in a process that may die or hang."""

    def __init__(self, world: "SimulatedRay"):
        self._world, self._board = world, Board()
        self._is_hanging = False
        self._refs: list[Ref] = []
        self.news = SimpleNamespace(remote=self._news)

    def _news(self, unwanted: Set[str]) -> Ref:
        self._world.touch()
        ref = Ref()
        if self._is_hanging:
            self._refs.append(ref)
            return ref
        for process in self._world.processes():
            process.sign(self._board)
        ref.resolve(self._board.news(unwanted))
        return ref

    def hang(self) -> None:
        """Answer no call any more."""
        self._is_hanging = True

    def die(self) -> None:
        """Die with all that it knows; Ray starts another process."""
        self._is_hanging, self._board = False, Board()
        for ref in self._refs:
            ref.resolve(_LOST)
        self._refs.clear()


class SimulatedRay:
    """The functions of the module `ray` that the dispatcher uses, and faults to let happen."""

    def __init__(self, clock: Clock, faults: Faults, is_local: bool):
        self.clock, self.faults, self.is_local = clock, faults, is_local
        self.is_dead = False
        self.nodes: dict[str, Node] = {}
        self._home = _HEAD  # the node of the driver, without cores unless the cluster is its own
        self._board: BoardHandle | None = None
        self.computed: list[tuple[str, int, float]] = []  # (digest, attempt, began)
        self._names: set[str] = set()
        self._numbers = itertools.count(1)

    def touch(self) -> None:
        """Note a question to Ray; a dead one would never answer."""
        if self.is_dead:
            raise Violation("a dead Ray was asked, which blocks for ever")

    def begin(self) -> None:
        """Start the cluster's first nodes, all new."""
        self.is_dead, self.nodes = False, {}
        self._names.clear()
        for _ in range(1 if self.is_local else 1 + int(3 * self.faults.rng.random())):
            self.add_node()
        if self.is_local:
            (self._home,) = self.nodes

    def add_node(self) -> None:
        """Let a machine join."""
        node = Node(f"{next(self._numbers):056x}", 1 + int(3 * self.faults.rng.random()))
        self.nodes[node.id] = node

    def end(self) -> None:
        """Let all processes die with Ray, or with the driver that has started them.

        Their calls are never answered.
        Ray frees the driver's names by the time another one has joined (tried with Ray 2.60).
        """
        self._names.clear()
        for process in self.processes():
            process.vanish()

    def lose(self, node: Node, is_cut_off: bool) -> None:
        """Let a machine go; Ray sees that later, and its processes may compute on."""
        node.is_reached = False
        if not is_cut_off:
            node.is_up = False
        lost = [process.call.ref for process in node.processes if process.call]

        def notice() -> None:
            node.is_seen = node.is_up = False
            refs = [process.call.ref for process in node.processes if process.call]
            for process in list(node.processes):
                process.die()
            for ref in [*lost, *refs]:
                ref.resolve(_LOST)

        self.clock.after(15.0 * self.faults.rng.random(), notice)

    def end_board(self) -> None:
        """Let the board die."""
        assert self._board is not None
        self._board.die()

    def hang_board(self) -> None:
        """Let the board answer nobody any more."""
        assert self._board is not None
        self._board.hang()

    def processes(self) -> list[Process]:
        """Processes of stages that live."""
        return [process for node in self.nodes.values() for process in node.processes]

    @contextmanager
    def in_place(self) -> Iterator[None]:
        """Let this be Ray, and its clock the time."""
        ours = {"wait": self._wait, "get": self._get, "kill": self._kill, "nodes": self._nodes}
        ours |= {"remote": self._remote, "get_runtime_context": self._context}
        now = self.clock.epoch_now
        with patch.multiple(ray, **ours), patch.multiple(time, monotonic=now, time=now):
            yield

    def _wait(
        self, refs: list[Ref], num_returns: int = 1, timeout: float | None = None
    ) -> tuple[list[Ref], list[Ref]]:
        self.touch()
        assert timeout == 0, "only the simulation's clock may wait"
        return [ref for ref in refs if ref.is_done], [ref for ref in refs if not ref.is_done]

    def _get(self, ref: Ref) -> Any:
        self.touch()
        if not ref.is_done:
            raise Violation("an answer was awaited that may never come")
        if isinstance(ref.answer, Exception):
            raise ref.answer
        return ref.answer

    def _kill(self, handle: Process | BoardHandle, no_restart: bool = True) -> None:
        self.touch()
        self.clock.after(0.5 * self.faults.rng.random(), handle.die)

    def _nodes(self) -> list[dict[str, Any]]:
        self.touch()
        nodes = [(node.id, node.is_seen, node.cpus) for node in self.nodes.values()]
        if not self.is_local:
            nodes.append((self._home, True, 0))
        return [
            {"NodeID": id, "Alive": is_seen, "Resources": {"CPU": float(cpus)}}
            for id, is_seen, cpus in nodes
        ]

    def _context(self) -> Any:
        return SimpleNamespace(get_node_id=lambda: self._home)

    def _remote(self, kind: type) -> Any:
        def options(**given: Any) -> Any:
            return SimpleNamespace(remote=lambda: self._start(kind, **given))

        return SimpleNamespace(options=options)

    def _start(self, kind: type, scheduling_strategy: Any, **given: Any) -> Process | BoardHandle:
        self.touch()
        if kind is Board:
            self._board = BoardHandle(self)
            return self._board
        name = given["name"]
        if name in self._names:  # Ray may keep the name of a dead actor
            raise ValueError(f"the name {name} is already taken")
        self._names.add(name)
        return Process(self, self.nodes.get(scheduling_strategy.node_id))


class SimulatedCluster:
    """The `Cluster` of a dispatcher, in a simulated Ray."""

    dashboard_url = None
    remedy = "as the schedule has it"

    def __init__(self, world: SimulatedRay):
        self._world, self.is_local = world, world.is_local

    @property
    def is_alive(self) -> bool:
        return not self._world.is_dead

    def start(self) -> None:
        """Start a local cluster, or join the one that is there, if it lives."""
        if self._world.is_local or self._world.is_dead or not self._world.nodes:
            self._world.begin()

    def restart(self) -> None:
        """Start a cluster again, or join another in the place of one that died, which may fail."""
        self._world.end()
        if self._world.faults.happens("Ray does not start"):
            raise ClusterUnavailable("Ray did not start: as the schedule has it")
        self._world.begin()

    def close(self) -> None:
        """Leave."""

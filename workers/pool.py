"""The cluster's cores, and the warm actors on each.

A core holds at most one actor of each role, of which at most one is busy: a trainer, which has
imported PyTorch and JAX, and an inference actor. They serve any run; either of them may compute a
visit to a simulated target. Idle ones end after a while.

Everything here runs on the dispatcher's thread.
"""

import itertools
import secrets
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from adr_service.stages.base import Role
from workers.actors import StageActor
from workers.cluster import RayOptions

# roles of the actors that can compute a stage; the first is started if there is none
_ABLE: dict[Role, tuple[Role, ...]] = {
    "trainer": ("trainer",),
    "inference": ("inference",),
    "target": ("inference", "trainer"),
}
_SHARE = 0.5  # of a core, for an actor: a core has room for both


@dataclass
class Actor:
    """A process on a core."""

    name: str
    role: Role
    handle: Any  # of a StageActor
    core: "Core"
    used: float = field(default_factory=time.monotonic)  # when it last began or ended a stage
    started: float = field(default_factory=time.monotonic)


@dataclass
class Core:
    """A core of a node."""

    node: str
    actors: dict[Role, Actor] = field(default_factory=dict[Role, Actor])
    busy: Actor | None = None

    def warm(self, role: Role, newer_than: float = 0.0) -> Actor | None:
        """An actor that can compute stages of a role, and was started after a moment."""
        able = (self.actors[r] for r in _ABLE[role] if r in self.actors)
        return next((actor for actor in able if actor.started > newer_than), None)


class Pool:
    """Hands out actors, one at a time per core."""

    def __init__(self, options: RayOptions):
        self._options = options
        self._cores: list[Core] = []
        self._home = ray.get_runtime_context().get_node_id()
        self.is_at_home = True  # the node on which this process stands is alive, as last seen
        # Ray frees the name of a dead actor late, if at all, also that of an earlier service's
        self._mark, self._numbers = secrets.token_hex(3), itertools.count(1)
        self.refresh()

    def __len__(self) -> int:
        return len(self._cores)

    def refresh(self) -> None:
        """Follow nodes that came and went, and end actors that were idle for too long."""
        resource = self._options.resource
        self._follow(
            {n["NodeID"]: int(n["Resources"].get(resource, 0)) for n in ray.nodes() if n["Alive"]}
        )
        too_long = time.monotonic() - self._options.keep_idle_s
        for core in self._cores:
            idle = [a for a in core.actors.values() if a is not core.busy and a.used < too_long]
            for actor in idle:
                self._end(actor)

    def take(
        self, role: Role, run_id: str, avoid: str | None, newer_than: float = 0.0
    ) -> Actor | None:
        """An actor for a stage, warm if possible; None if all cores are busy, or `max_cores`.

        Avoids the node `avoid` if there are others, and prefers nodes at work, so that the rest
        become idle and can be released. A new actor is named after its first run. Actors started
        before `newer_than` (monotonic) count as dead: when a stage lost its process, idle actors
        may have died as well.
        """
        others = {core.node for core in self._cores} - {avoid}
        busy = Counter(core.node for core in self._cores if core.busy is not None)
        free = [core for core in self._cores if core.busy is None]
        free = [core for core in free if core.node != avoid or not others]
        if not free or busy.total() >= (self._options.max_cores or len(self._cores)):
            return None

        def rank(core: Core) -> tuple[bool, bool, int]:
            warm, old = core.warm(role, newer_than), core.warm(role)
            return warm is None, old is not warm, -busy[core.node]

        core = min(free, key=rank)
        core.busy = core.warm(role, newer_than) or self._start(core, _ABLE[role][0], run_id)
        return core.busy

    def give_back(self, actor: Actor) -> None:
        """Let an actor's core be free again."""
        actor.used, actor.core.busy = time.monotonic(), None

    def lose(self, actor: Actor) -> None:
        """Forget an actor whose process has died."""
        del actor.core.actors[actor.role]
        actor.core.busy = None

    def _end(self, actor: Actor) -> None:
        """End an idle actor, if its process has not died."""
        del actor.core.actors[actor.role]
        ray.kill(actor.handle)

    def _follow(self, cores: dict[str, int]) -> None:
        """Have as many cores of each node as it has; busy ones of dead nodes stay until the end."""
        self.is_at_home = self._home in cores
        known = [core.node for core in self._cores]
        self._cores = [core for core in self._cores if core.busy or core.node in cores]
        for node, count in cores.items():
            self._cores += [Core(node) for _ in range(count - known.count(node))]

    def _start(self, core: Core, role: Role, run_id: str) -> Actor:
        if role in core.actors:
            self._end(core.actors[role])
        name = f"adr:{run_id}:{role}:{self._mark}-{next(self._numbers)}"
        here = NodeAffinitySchedulingStrategy(core.node, soft=False)
        others = {self._options.resource: _SHARE} if self._options.resource != "CPU" else None
        handle = ray.remote(StageActor).options(
            name=name,
            scheduling_strategy=here,
            num_cpus=_SHARE,
            resources=others,
            max_restarts=0,
            max_task_retries=0,
        )
        core.actors[role] = actor = Actor(name, role, handle.remote(), core)
        return actor

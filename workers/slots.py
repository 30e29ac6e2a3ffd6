"""The cluster's cores, and the processes that stay warm on each.

A core has a slot. It holds at most one actor of each role, of which at most one is busy: a
trainer, which has imported PyTorch and JAX, and an inference actor. They serve whatever run asks;
a visit to a simulated target is made by either. Idle ones end after a while.

Everything here runs on the dispatcher's thread.
"""

import itertools
import time
from dataclasses import dataclass, field
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from adr_service.stages import Role
from workers.actors import StageActor

# whose actors can do what; the first is started where there is none
_ABLE: dict[Role, tuple[Role, ...]] = {
    "trainer": ("trainer",),
    "inference": ("inference",),
    "target": ("inference", "trainer"),
}
_CPUS = 0.5  # what Ray counts for an actor: a core has room for both


@dataclass
class Actor:
    """A process on a core."""

    name: str
    role: Role
    handle: Any  # of a StageActor
    slot: "Slot"
    used: float = field(default_factory=time.monotonic)


@dataclass
class Slot:
    """A core of a node."""

    node: str
    actors: dict[Role, Actor] = field(default_factory=dict[Role, Actor])
    busy: Actor | None = None

    def able(self, role: Role) -> Actor | None:
        """A warm actor for stages of a role."""
        return next((self.actors[r] for r in _ABLE[role] if r in self.actors), None)


class Slots:
    """Hands out actors, one at a time per core."""

    def __init__(self, keep_idle_s: float):
        self._keep_idle_s = keep_idle_s
        self._slots: list[Slot] = []
        self.nodes = 0  # alive, as last seen
        self._numbers = itertools.count(1)  # Ray frees the name of a dead actor late, if at all
        self.refresh()

    def __len__(self) -> int:
        return len(self._slots)

    def refresh(self) -> None:
        """Follow nodes that came and went, and end who has been idle for too long."""
        cores = {n["NodeID"]: int(n["Resources"].get("CPU", 0)) for n in ray.nodes() if n["Alive"]}
        self.nodes = len(cores)
        known = [slot.node for slot in self._slots]
        self._slots = [slot for slot in self._slots if slot.busy or slot.node in cores]
        for node, count in cores.items():
            self._slots += [Slot(node) for _ in range(count - known.count(node))]
        too_long = time.monotonic() - self._keep_idle_s
        for slot in self._slots:
            idle = [a for a in slot.actors.values() if a is not slot.busy and a.used < too_long]
            for actor in idle:
                del slot.actors[actor.role]
                ray.kill(actor.handle)

    def take(self, role: Role, run_id: str, avoid: str | None) -> Actor | None:
        """An actor for a stage, warm if possible, and not on the node to avoid if there are others.

        None: all cores are busy. A new actor is named after the run that it is started for.
        """
        others = {slot.node for slot in self._slots} - {avoid}
        free = [slot for slot in self._slots if slot.busy is None]
        free = [slot for slot in free if slot.node != avoid or not others]
        if not free:
            return None
        slot = min(free, key=lambda slot: slot.able(role) is None)
        slot.busy = slot.able(role) or self._start(slot, _ABLE[role][0], run_id)
        return slot.busy

    def give_back(self, actor: Actor) -> None:
        actor.used, actor.slot.busy = time.monotonic(), None

    def lose(self, actor: Actor) -> None:
        """Its process has died."""
        del actor.slot.actors[actor.role]
        actor.slot.busy = None

    def _start(self, slot: Slot, role: Role, run_id: str) -> Actor:
        name = f"adr:{run_id}:{role}:{next(self._numbers)}"
        here = NodeAffinitySchedulingStrategy(slot.node, soft=False)
        options = {"num_cpus": _CPUS, "max_restarts": 0, "max_task_retries": 0}
        handle = ray.remote(StageActor).options(name=name, scheduling_strategy=here, **options)
        slot.actors[role] = actor = Actor(name, role, handle.remote(), slot)
        return actor

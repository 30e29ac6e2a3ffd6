"""Blind test of criticism where what is hidden has a memory, which no effect that it tries has.

    python -m benchmarks.memories [cases, 24] [seed, 1]

One joint of the arm has a friction whose bristles bend before they slip (Dahl's), or a drive that
loses torque as it warms up. Either has a state of its own, so that no function of motion, commands
and time is its force. Ratios to the noise of a difference of two readings are .3 and 1 by turns
(`benchmarks.criticism` sizes otherwise), and measurements are as there. As many processes at once
as there are cores, each with one thread (set OMP_NUM_THREADS=1). Prints a line for each case and
counts those in which something is called unknown. Writes build/bench/memories.json after every
case, and goes on from there where it was interrupted, while the method is the same.
"""

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np

from adr_service.blind_test.planting import EPISODES, STEPS, hide
from adr_service.blind_test.sizing import noise_of
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.nominal import Nominal
from adr_service.criticism.pipeline import criticise
from adr_service.criticism.simulator import Simulator
from adr_service.tasks.catalogue import get_task, source_of
from benchmarks.criticism import METHOD
from benchmarks.ended_cases import all_cases, digest_of

PATH = Path("build/bench/memories.json")
RATIOS = (0.3, 1.0)
_OFF = 0.1  # relative error of the parameters that the diagnosis starts from


class Memory(ABC):
    """A force on a joint, in proportion to `size` [N m]. It forgets where an episode ends."""

    shapes: ClassVar[tuple[float, float]]  # what `shape` is drawn from, between their logarithms

    def __init__(self, dof: int, size: float, shape: float):
        self.dof, self._size, self._shape = dof, size, shape
        self._kept = self._before = 0.0  # what it remembers, and when [s] it was asked last
        self.forces: list[float] = []  # one for every step so far

    def at(self, data: mujoco.MjData, seconds: float, length: float) -> float:
        if data.time == 0:
            self._kept = self._before = 0.0
        passed, self._before = data.time - self._before, data.time
        towards, rate, acts = self._now(float(data.qvel[self.dof]), float(data.ctrl[self.dof]))
        self._kept = towards + (self._kept - towards) * float(np.exp(-rate * passed))
        self.forces.append(-self._size * self._kept * acts)
        return self.forces[-1]

    @abstractmethod
    def _now(self, velocity: float, command: float) -> tuple[float, float, float]:
        """Value that the memory goes towards, how fast [1/s], and what it is multiplied with.

        The command is that of the drive of the joint's number.
        """


class Bristles(Memory):
    """Dahl's friction. Size is that of sliding; shape [rad] is how far the bristles bend."""

    shapes = (0.05, 0.3)

    def _now(self, velocity: float, command: float) -> tuple[float, float, float]:
        return float(np.sign(velocity)), abs(velocity) / self._shape, 1.0


class Heat(Memory):
    """A drive that loses torque as squared commands warm it. Shape is the time that takes [s]."""

    shapes = (0.2, 1.0)

    def _now(self, velocity: float, command: float) -> tuple[float, float, float]:
        return command**2, 1 / self._shape, command


KINDS: dict[str, type[Memory]] = {"bristles": Bristles, "heat": Heat}


def one(job: tuple[int, int]) -> dict[str, Any]:
    """One case: what was hidden, and what was said of it."""
    number, seed = job
    rng = np.random.default_rng([seed, number])
    kind, ratio = list(product(KINDS, RATIOS))[number % (len(KINDS) * len(RATIOS))]
    nominal = Nominal.of_task(get_task("arm"), source_of("arm", "vanilla"))
    dof, data = hidden(nominal, KINDS[kind], ratio, rng)
    start = nominal.start * (1 + _OFF * rng.uniform(-1, 1, len(nominal.start)))
    started = time.process_time()
    verdict = criticise(replace(nominal, start=start), data, rng, threads=1).verdict
    return {
        "number": number,
        "kind": kind,
        "ratio": ratio,
        "dof": dof,
        "conclusion": verdict.conclusion.value,
        "rest": verdict.residual.rest,
        "causes": [f"{cause.kind} {cause.location}" for cause in verdict.causes],
        "explained": None if verdict.gain is None else verdict.gain.explainable_fraction,
        "cpu_seconds": time.process_time() - started,
    }


def hidden(
    nominal: Nominal, kind: type[Memory], ratio: float, rng: np.random.Generator
) -> tuple[int, Measurement]:
    """A joint that has such a memory, as strong as the ratio says, and a measurement of its arm."""
    base = nominal.model(nominal.start)
    dof, seed = int(rng.integers(base.nv)), int(rng.integers(2**32))
    size, shape = 0.1, float(np.exp(rng.uniform(*np.log(kind.shapes))))
    while True:  # the robot's motion changes with the size
        memory = kind(dof, size, shape)
        data = hide(get_task("arm"), nominal, np.random.default_rng(seed), [], memory)
        reached = _ratio_of(memory, nominal, data)
        if abs(reached / ratio - 1) < 0.05:
            return dof, data
        size *= ratio / reached


def _ratio_of(memory: Memory, nominal: Nominal, data: Measurement) -> float:
    """Root mean square of what the force changes in a control step, in units of the noise of a
    difference of two readings."""
    simulator = Simulator(nominal, data, threads=1)
    response = simulator.responses_to_forces(nominal.start, (), simulator.measured)[memory.dof]
    steps = np.reshape(memory.forces, (EPISODES, STEPS + 1, -1))
    force = steps[:, :-1].mean(axis=2).ravel()  # no transition begins in an episode's last row
    changed = response * force[:, None] / (np.sqrt(2) * noise_of(simulator.base))
    return float(np.sqrt(np.nanmean(changed**2)))


def _line(case: dict[str, Any]) -> str:
    said = ", ".join(case["causes"]) or case["conclusion"]
    explained = "" if case["explained"] is None else f", {case['explained']:.0%} explained"
    return (
        f"{case['number']:3d} {case['kind']:8s} {case['ratio']:g} -> {said}, rest {case['rest']}"
        f"{explained}, {case['cpu_seconds']:.0f} s"
    )


def table(cases: Sequence[dict[str, Any]]) -> str:
    """Lines that count, by kind and ratio, where something is called unknown."""
    lines: list[str] = []
    for kind, ratio in product(KINDS, RATIOS):
        rests = [c["rest"] for c in cases if (c["kind"], c["ratio"]) == (kind, ratio)]
        lines.append(f"{kind}, {ratio:g}: unknown {rests.count('unknown')} of {len(rests)}")
    return "\n".join(lines)


def main(cases: str = "24", seed: str = "1") -> None:
    jobs = [(number, int(seed)) for number in range(int(cases))]
    code = digest_of(*(f"adr_service/{name}" for name in METHOD), "benchmarks/memories.py")
    origin = {"seed": int(seed), "code": code}
    print(table(all_cases(PATH, origin, jobs, one, lambda c: (c["number"], int(seed)), _line)))


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Chance of each fault in a schedule, and how often it came."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np


class Violation(BaseException):
    """Something that must never be; nothing of the service may catch this."""


class ServiceDied(BaseException):
    """The service's process ends here, as by kill -9; nothing of it may catch this."""


# largest chance of each fault, per occasion; a schedule draws its own chances below these
CHANCES = {
    "process dies": 0.3,
    "process hangs": 0.15,
    "process hangs before its first sign": 0.1,
    "process pauses and answers late": 0.15,
    "stage does not ask whether to stop": 1.0,
    "stage fails": 0.05,
    "stage cannot be unpacked": 0.03,
    "idle process dies": 0.1,
    "node dies": 0.8,
    "node is cut off and computes on": 0.5,
    "Ray dies": 0.5,
    "Ray does not start": 0.3,
    "board dies": 0.5,
    "board hangs": 0.5,
    "database goes away": 0.8,
    "database goes away before its answer": 0.2,
    "database refuses a result": 0.02,
    "service dies in a transaction": 0.02,
    "service dies between rounds": 0.5,
    "run is cancelled": 0.5,
    "robot answers late": 0.3,
    "robot answers twice": 0.3,
    "robot gives up": 0.1,
}


@dataclass
class Faults:
    """The chances of one schedule. Most schedules have few kinds of faults, some have all."""

    rng: np.random.Generator
    injected: Counter[str] = field(default_factory=Counter[str])
    are_over: bool = False  # so that everything must come to an end

    def __post_init__(self) -> None:
        violence = self.rng.random() ** 2
        drawn = self.rng.random((2, len(CHANCES)))
        self._chances = {
            name: most * amount if wanted < violence + 0.1 else 0.0
            for (name, most), amount, wanted in zip(CHANCES.items(), *drawn.tolist(), strict=True)
        }

    def happens(self, name: str) -> bool:
        """True if the fault comes now; it is counted."""
        chance = self._chances[name]
        if not chance or self.are_over or self.rng.random() >= chance:
            return False
        self.injected[name] += 1
        return True

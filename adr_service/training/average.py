"""The running mean of a policy's weights over a training's last steps.

Weights that are learned with a constant learning rate move around a good point, and their mean is
closer to it (Polyak and Juditsky, 1992, whose mean is uniform; this one is exponential). The mean
is of the exported layers, which have the normalisation in them, so that it is the same for all
algorithms.
"""

import math
from dataclasses import replace

import numpy as np

from adr_service.training.policy import Policy

_SAMPLES = 20  # policies within the steps that are averaged over


class Average:
    """The mean of policies, whose shares fall to 1/e after `steps` environment steps.

    Policies are added 20 times in so many steps, or every `at_least_every` steps where those are
    fewer.
    """

    def __init__(self, steps: int, at_least_every: float = math.inf):
        self._steps = steps
        self._interval = min(steps / _SAMPLES, at_least_every)
        self._added_at = -self._interval  # environment steps before the last policy
        self._total = 0.0  # share of all policies, which rises to 1
        self._sums: list[tuple[np.ndarray, np.ndarray]] = []  # of weighted layers, in float64

    def is_due(self, done: int) -> bool:
        """True if it is time to add a policy, after `done` steps."""
        return done - self._added_at >= self._interval

    def add(self, policy: Policy, done: int) -> Policy:
        """Add the policy after `done` steps, and return the policy with the mean weights."""
        if not self._sums:
            self._sums = [
                (np.zeros(weight.shape), np.zeros(bias.shape)) for weight, bias in policy.layers
            ]
        old = math.exp((self._added_at - done) / self._steps)
        self._added_at, self._total = done, old * self._total + (1 - old)
        for sums, latest in zip(self._sums, policy.layers, strict=True):
            for kept, part in zip(sums, latest, strict=True):
                np.add(old * kept, (1 - old) * part, out=kept)
        layers = tuple(
            ((weight / self._total).astype(np.float32), (bias / self._total).astype(np.float32))
            for weight, bias in self._sums
        )
        return replace(policy, layers=layers)

"""The running mean of a policy's weights over a training's last steps.

Weights that are learned with a constant learning rate move around a good point, and their mean is
closer to it (Polyak and Juditsky, 1992). The mean is of the exported layers, which have the
normalisation in them, so that it is the same for all algorithms.
"""

import math
from dataclasses import replace

import numpy as np

from adr_service.training.policy import Policy

_SAMPLES = 20  # policies within the steps that are averaged over


class Average:
    """A mean with exponentially falling weights, over about `steps` environment steps."""

    def __init__(self, steps: int):
        self._steps = steps
        self._added_at: int | None = None  # environment steps before the last policy
        self._mean: list[tuple[np.ndarray, np.ndarray]] = []  # layers in float64

    def is_due(self, done: int) -> bool:
        """True if it is time to add a policy, after `done` steps."""
        return self._added_at is None or done - self._added_at >= self._steps / _SAMPLES

    def add(self, policy: Policy, done: int) -> Policy:
        """The policy with the mean of its own weights, after `done` steps, and of those before."""
        if self._added_at is None:
            self._mean = [
                (weight.astype(float), bias.astype(float)) for weight, bias in policy.layers
            ]
            self._added_at = done
        new = 1 - math.exp((self._added_at - done) / self._steps)
        for mean, latest in zip(self._mean, policy.layers, strict=True):
            for kept, part in zip(mean, latest, strict=True):
                np.add(kept, new * (part - kept), out=kept)
        self._added_at = done
        layers = tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in self._mean)
        return replace(policy, layers=layers)

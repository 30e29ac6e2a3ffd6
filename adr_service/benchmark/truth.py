"""The hidden truth of simulated targets, for reports alone."""

import numpy as np

from adr_service.arrays import Vector
from adr_service.tasks.catalogue import hidden_of, variant_of


def estimation_error(task: str, variant: str, mean: Vector) -> float:
    """Root-mean-square distance of an estimate's mean (d,) from the truth, in [0, 4] coordinates.

    Over the parameters of the variant's source space.
    """
    pair = variant_of(task, variant)
    space, truth = pair.source.space, pair.truth
    return float(np.sqrt(np.mean((space.normalise(mean) - space.normalise(truth)) ** 2)))


def true_values(task: str, variant: str) -> dict[str, float]:
    """The hidden truth by parameter name, in SI units."""
    hidden = hidden_of(task, variant)
    return dict(zip(hidden.source.space.names, hidden.values.tolist(), strict=True))

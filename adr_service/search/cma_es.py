"""CMA-ES over a box, by pycma, with random numbers from our stream.

    es = strategy(np.full(8, 2.0), std=1.0, width=4.0, rng=rng)
    while not es.stop():
        candidates = es.ask()
        es.tell(candidates, [loss(x) for x in candidates])

Hansen: "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772.
"""

from typing import TYPE_CHECKING

import numpy as np

from adr_service.arrays import Matrix, Vector
from adr_service.startup_time import preparing

if TYPE_CHECKING:  # pycma takes a third of a second to import
    import cma


def strategy(
    start: Vector, *, std: float, width: float, rng: np.random.Generator
) -> "cma.CMAEvolutionStrategy":
    """A search in [0, width]^d from `start` (d,), bounded by pycma's transformation."""
    with preparing():
        import cma

    return cma.CMAEvolutionStrategy(
        start.tolist(),
        std,
        {
            "bounds": [0, width],
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,  # or pycma would seed NumPy's global generator
            "signals_filename": "",  # or pycma would read options from the working directory
            "verbose": -9,
        },
    )


def belief(es: "cma.CMAEvolutionStrategy") -> tuple[Vector, Matrix]:
    """Mean (d,) and covariance (d, d) of the search's Gaussian.

    The search draws x ~ N(m, s² C) (eq. 5), with `stds` s sqrt(diag C), and pycma's transformation
    moves x into the box. The mean is transformed, the covariance is not. The transformation is
    quadratic within .05 of 0 and within max(1, width) / 20 of the width, .2 of 4, and the identity
    between. The covariance is that of the draws, with two exceptions. Near a bound its deviations
    are too large, without limit as the search narrows. While the search is as wide as the box, it
    is off by a third (20 parameters, 15 generations).
    """
    shape: Matrix = np.asarray(es.C, dtype=np.float64)
    scale = np.asarray(es.result.stds, dtype=np.float64) / np.sqrt(np.diag(shape))
    return np.asarray(es.result.xfavorite, dtype=np.float64), scale[:, None] * shape * scale

"""CMA-ES over a box, by pycma, its random numbers ours.

es = strategy(np.full(8, 2.0), std=1.0, width=4.0, rng=rng)
while not es.stop():
    candidates = es.ask()
    es.tell(candidates, [loss(x) for x in candidates])
"""

import cma
import numpy as np

from adr_service.arrays import Matrix, Vector


def strategy(
    start: Vector, *, std: float, width: float, rng: np.random.Generator
) -> cma.CMAEvolutionStrategy:
    """A search in [0, width]^d from `start`, bounded by pycma's transformation."""
    return cma.CMAEvolutionStrategy(
        start.tolist(),
        std,
        {
            "bounds": [0, width],
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,  # or pycma would seed NumPy's global generator
            "verbose": -9,
        },
    )


def belief(es: cma.CMAEvolutionStrategy) -> tuple[Vector, Matrix]:
    """Mean (d,) and covariance (d, d) of the search's own Gaussian, in the box's coordinates."""
    shape: Matrix = np.asarray(es.C, dtype=np.float64)
    scale = np.asarray(es.result.stds, dtype=np.float64) / np.sqrt(np.diag(shape))
    return np.asarray(es.result.xfavorite, dtype=np.float64), scale[:, None] * shape * scale

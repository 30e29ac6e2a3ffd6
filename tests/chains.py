"""Residuals of episodes that are drawn with known variances."""

import numpy as np

from adr_service.criticism.linear import Linear
from adr_service.criticism.noise import Chain

EPISODES, STEPS, WIDTH = 20, 30, 2
EXACT = np.full(WIDTH, 1e-24)
SENSOR, MISFIT = np.array([1.0, 4.0]), np.array([[0.01, 0.04], [0.5, 2.0]])


def drawn(sensor, misfit, rng):
    """A chain and residuals with these variances."""
    mask = np.ones((EPISODES, STEPS), dtype=bool)
    mask[3, 20:] = False
    transition = np.eye(WIDTH) + 0.3 * rng.standard_normal((EPISODES, STEPS, WIDTH, WIDTH))
    transition[~mask] = 0.0
    stiff = rng.random((EPISODES, STEPS)) < 0.3
    errors = np.sqrt(sensor) * rng.standard_normal((EPISODES, STEPS + 1, WIDTH))
    wrong = np.sqrt(misfit)[stiff.astype(int)] * rng.standard_normal((EPISODES, STEPS, WIDTH))
    passed = (transition @ errors[:, :-1, :, None])[..., 0]
    residual = np.where(mask[..., None], errors[:, 1:] - passed + wrong, 0.0)
    return Chain(mask, transition, stiff, np.ones(WIDTH, bool), EXACT), residual, errors


def interrupted(chain, residual):
    """The same, but one transition is missing in the middle of an episode."""
    mask = chain.mask.copy()
    mask[2, 7] = False
    return chain.where(mask), np.where(mask[..., None], residual, 0.0)


def remembered(chain, residual, share):
    """A chain with memory, and what is new in its residuals."""
    linear = unexplained(chain, residual).remembering(share)
    return linear.chain, linear.residual


def unexplained(chain, residual):
    """Residuals beside which there are no columns."""
    columns = np.empty((*residual.shape, 0))
    return Linear(chain, residual, columns, mean=np.empty(0), precision=np.empty(0))

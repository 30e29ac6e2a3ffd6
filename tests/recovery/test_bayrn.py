"""BayRn finds the optimum of a known return surface."""

import numpy as np
import pytest

from adr_service.methods.bayrn import propose
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.randomness import stream
from tests.planted import SPACE

FORE_MASS = SPACE.subset(("fore_mass",))


def earned(box):
    """A return that is best, 100, at a mean of 1.5 kg and a width of 0.5 kg."""
    return 100 - 10 * (box.mean[0] - 1.5) ** 2 - 5 * (box.high[0] - box.low[0] - 0.5) ** 2


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_bayrn_finds_the_optimum_of_a_known_return_surface(seed):
    """Tolerance: a regret of .1 of 100; with seeds 0 to 4 the worst after ten was below .01.

    Of fifteen random boxes, the best has a regret of more than .1 nearly always.
    """
    boxes = random_bounds(FORE_MASS, UdrSettings(policies=5), stream("bayrn", seed))
    returns = [earned(box) for box in boxes]
    rng = stream("propose", seed)
    for _ in range(10):
        proposal = propose(boxes, np.array(returns), rng)
        boxes.append(proposal.next)
        returns.append(earned(proposal.next))
    final = propose(boxes, np.array(returns), rng)
    assert returns[final.best] > 100 - 0.1
    others = random_bounds(FORE_MASS, UdrSettings(policies=15), stream("random", seed))
    assert returns[final.best] > max(map(earned, others))

"""The Hopper of DROPO's published recordings, whose noise is on next observations alone."""

from adr_service.methods.base import Problem
from adr_service.progress import silent
from adr_service.randomness import stream
from adr_service.tasks.catalogue import get_task, variants_of
from tests.planted import distance

HOPPER, VANILLA = get_task("hopper"), variants_of("hopper")["vanilla"]
PROBLEM = Problem(HOPPER, VANILLA.source)


def distance_from_the_masses(method, data):
    """Root mean square over the masses, in [0, 4] coordinates; .70 for the prior."""
    estimate = method.fit(PROBLEM, data, stream("hopper", 0), silent)
    return distance(estimate.distribution.mean, VANILLA.truth, VANILLA.source.space)

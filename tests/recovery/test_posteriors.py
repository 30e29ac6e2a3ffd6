"""BayesSim and NPDR recover planted dynamics, within what their posteriors say."""

import numpy as np
import pytest

from adr_service.distributions import normalised_std
from adr_service.methods.bayes_sim import BayesSimSettings
from adr_service.methods.npdr import NpdrSettings
from adr_service.progress import silent
from adr_service.randomness import stream
from tests.planted import PLANTED, PROBLEM, SPACE, recorded, waving_policy

pytestmark = pytest.mark.slow
SETTINGS = {"bayes_sim": BayesSimSettings(), "npdr": NpdrSettings()}


def fitted(name, data, **changes):
    settings = SETTINGS[name].model_copy(update=changes)
    return settings.create().fit(PROBLEM, data, stream("posterior", name), silent)


def distance(estimate):
    truth = SPACE.normalise(PLANTED)
    mean = SPACE.normalise(estimate.distribution.mean)
    return np.sqrt(np.mean((mean - truth) ** 2)), (mean - truth) / normalised_std(
        estimate.distribution
    )


@pytest.mark.parametrize(("name", "tolerance"), [("bayes_sim", 0.25), ("npdr", 0.1)])
def test_planted_dynamics_are_recovered(name, tolerance):
    """Tolerance: root mean square in [0, 4], where the prior's mean is .75 away."""
    estimate = fitted(name, recorded(waving_policy()))
    found, deviations = distance(estimate)
    assert found < tolerance
    assert np.abs(deviations).max() < 4


@pytest.mark.parametrize("name", SETTINGS)
def test_two_steps_are_too_little_evidence(name):
    """The control, which must fail: two steps tell little, so the posterior is wide or wrong."""
    estimate = fitted(name, recorded(waving_policy(), steps=2))
    assert distance(estimate)[0] > 0.25 or normalised_std(estimate.distribution).mean() > 0.5

"""BayesSim and NPDR recover planted dynamics, within what their posteriors say."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.distributions import normalised_std
from adr_service.methods.bayes_sim import BayesSimSettings
from adr_service.methods.npdr import NpdrSettings
from adr_service.progress import silent
from adr_service.randomness import stream
from tests.planted import PLANTED, PROBLEM, SPACE, recorded, waving_policy
from tests.recovery import hopper

pytestmark = pytest.mark.slow
SETTINGS = {"bayes_sim": BayesSimSettings(), "npdr": NpdrSettings()}


def fitted(name, data, **changes):
    settings = SETTINGS[name].model_copy(update=changes)
    return settings.create().fit(PROBLEM, data, stream("posterior", name), silent)


def errors(estimate):
    """The errors of the mean, in [0, 4]."""
    return SPACE.normalise(estimate.distribution.mean) - SPACE.normalise(PLANTED)


def distance(estimate):
    """Root mean square of the errors."""
    return np.sqrt(np.mean(errors(estimate) ** 2))


@pytest.mark.parametrize(("name", "tolerance"), [("bayes_sim", 0.25), ("npdr", 0.1)])
def test_planted_dynamics_are_recovered(name, tolerance):
    """Tolerance: root mean square in [0, 4], where the prior's mean is .91 away."""
    estimate = fitted(name, recorded(waving_policy()))
    assert distance(estimate) < tolerance
    assert np.all(np.abs(errors(estimate)) < 4 * normalised_std(estimate.distribution))


@pytest.mark.parametrize("name", SETTINGS)
def test_actions_in_a_wrong_order_recover_nothing(name):
    """The control, which must fail."""
    data = recorded(waving_policy())
    estimate = fitted(name, replace(data, actions=data.actions[::-1]))
    assert distance(estimate) > 0.25
    assert np.max(estimate.diagnostics["statistics_outside"]) > 0


@pytest.mark.parametrize(("name", "widest"), [("bayes_sim", 0.75), ("npdr", 0.25)])
def test_posteriors_of_the_published_recording_contain_hoppers_masses(name, widest, hopper_clean):
    """Every mass lies within 95 % of the draws, which are that share of the search box at most.

    Of the uniform prior they are .95 of it.
    """
    estimate = (
        SETTINGS[name]
        .create()
        .fit(hopper.PROBLEM, hopper_clean.first(200), stream("published", name), silent)
    )
    draws = estimate.distribution.sample(4000, stream("draws")).values
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    assert np.all((low <= hopper.VANILLA.truth) & (hopper.VANILLA.truth <= high)), (low, high)
    space = hopper.VANILLA.source.space
    assert np.all(space.normalise(high) - space.normalise(low) <= widest * space.WIDTH), (low, high)

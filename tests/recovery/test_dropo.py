"""DROPO recovers planted dynamics and spreads of the arm, and the published Hopper's masses."""

import numpy as np
import pytest

from adr_service.distributions import TruncatedGaussian, normalised_std
from adr_service.methods.dropo import Dropo, DropoSettings, EDropoSettings
from adr_service.progress import silent
from adr_service.randomness import stream
from tests.planted import PLANTED, PROBLEM, SPACE, distance, recorded, waving_policy
from tests.recovery import hopper


def e_dropo(entropy):
    return EDropoSettings(epsilon=1e-4, entropy=entropy)


@pytest.mark.parametrize(
    ("noise", "epsilon", "tolerance"), [(0.0, 1e-6, 0.001), (0.003, 2e-5, 0.02)]
)
def test_dropo_recovers_planted_dynamics(noise, epsilon, tolerance):
    """The worst of seeds 0 to 4 are .0000 and .0059; tolerance, three times that."""
    data = recorded(waving_policy(), noise=noise)
    settings = DropoSettings(samples_per_parameter=4, epsilon=epsilon)
    estimate = Dropo(settings).fit(PROBLEM, data, stream("dropo"), silent)
    assert distance(estimate.distribution.mean) < tolerance


def test_dropo_recovers_a_planted_spread():
    """Each episode has its own forearm mass. Tolerance of the deviation: a half."""
    spread = TruncatedGaussian(SPACE, PLANTED, np.array([1e-4, 0.5, 1e-4, 1e-4]))
    dynamics = spread.sample(16, np.random.default_rng(0)).values
    data = recorded(waving_policy(), dynamics, episodes=16, steps=12)
    settings = DropoSettings(samples_per_parameter=5, epsilon=1e-6)
    estimate = Dropo(settings).fit(PROBLEM, data, stream("spread"), silent).distribution
    assert estimate.std[1] == pytest.approx(float(np.std(dynamics[:, 1])), rel=0.5)
    assert estimate.mean[1] == pytest.approx(PLANTED[1], rel=0.2)
    assert estimate.std[0] < 0.25


def test_a_bonus_keeps_the_deviations_from_collapsing_and_the_means_in_place():
    """Tolerance: with noise, twice DROPO's distance. Deviations grow with the bonus, as its root:
    .006 to .03 of [0, 4] for a tenth of a nat and an epsilon of 1e-5."""
    data = recorded(waving_policy(), noise=0.003)
    stds, distances = [], []
    for settings in (DropoSettings(epsilon=1e-4), e_dropo(0.01), e_dropo(0.1)):
        found = settings.create().fit(PROBLEM, data, stream("entropy"), silent).distribution
        stds.append(normalised_std(found))
        distances.append(distance(found.mean))
    assert np.all(stds[0] < 1e-3)
    assert stds[2] / stds[1] == pytest.approx([np.sqrt(10)] * 4, rel=0.4)
    assert max(distances) < 2 * distances[0]


def test_a_bonus_above_what_data_can_lose_takes_all_the_width_there_is():
    found = e_dropo(10.0).create().fit(PROBLEM, recorded(waving_policy()), stream("e"), silent)
    assert found.diagnostics["widest"] == list(SPACE.names)


def test_dropo_recovers_the_published_hopper_masses(hopper_clean):
    """Tolerance: 2 %, from 200 transitions."""
    settings = DropoSettings(epsilon=1e-5)
    data = hopper_clean.first(200)
    estimate = Dropo(settings).fit(hopper.PROBLEM, data, stream("published"), silent)
    np.testing.assert_allclose(estimate.distribution.mean, hopper.VANILLA.truth, rtol=0.02)


@pytest.mark.slow  # the clean recording is recovered by the fast suite
def test_dropo_recovers_hoppers_masses_from_noisy_transitions(hopper_noisy):
    """Tolerance: three times the distance with 200 transitions, .0064."""
    settings = DropoSettings(epsilon=1e-5)
    assert hopper.distance_from_the_masses(Dropo(settings), hopper_noisy.first(200)) < 0.02

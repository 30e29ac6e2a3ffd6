"""The Gaussian process: it follows its data, and proposes where more is expected."""

import numpy as np
import torch

from adr_service.randomness import stream
from adr_service.search.bayesian import Surrogate


def hill(points):
    """A smooth surface on the unit square with its top at (0.3, 0.7)."""
    return -np.sum((points - [0.3, 0.7]) ** 2, axis=1)


POINTS = stream("points").random((12, 2))


def test_the_mean_follows_smooth_data():
    surrogate = Surrogate(POINTS, hill(POINTS), stream("fit"))
    np.testing.assert_allclose(surrogate.mean(POINTS), hill(POINTS), atol=0.02)


def test_values_of_noise_alone_are_not_followed():
    """The means spread .35 times as far as the values; with the noise's prior of today, .78."""
    shares = []
    for number in range(8):
        rng = stream("noise", number)
        points, values = rng.random((15, 2)), rng.normal(0.8, 0.22, 15)
        means = Surrogate(points, values, rng).mean(points)
        shares.append(means.std() / values.std())
    assert np.mean(shares) < 0.6


def test_scaling_and_shifting_the_values_scales_and_shifts_the_mean():
    """The values are standardised."""
    fresh = stream("fresh").random((5, 2))
    plain = Surrogate(POINTS, hill(POINTS), stream("fit")).mean(fresh)
    scaled = Surrogate(POINTS, 1000 + 50 * hill(POINTS), stream("fit")).mean(fresh)
    np.testing.assert_allclose(scaled, 1000 + 50 * plain, rtol=1e-4)


def test_proposals_stay_in_the_cube_and_approach_the_top():
    points, values = POINTS[:5], hill(POINTS[:5])
    for i in range(6):
        proposal = Surrogate(points, values, stream("propose", i)).propose()
        assert np.all((proposal >= 0) & (proposal <= 1))
        points = np.vstack([points, proposal])
        values = hill(points)
    assert values.max() > -0.005


def test_the_same_stream_proposes_the_same_and_torchs_generator_goes_on():
    torch.manual_seed(3)
    expected = torch.rand(1)
    torch.manual_seed(3)
    first, again = (Surrogate(POINTS, hill(POINTS), stream("same")).propose() for _ in range(2))
    assert torch.rand(1) == expected
    np.testing.assert_array_equal(first, again)


def test_equal_values_still_give_a_finite_proposal():
    proposal = Surrogate(POINTS, np.full(12, 3.0), stream("flat")).propose()
    assert np.all(np.isfinite(proposal))

"""BayRn's encoding of bounds, and its proposals."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from adr_service.distributions import Uniform
from adr_service.methods.bayrn import decode, encode, propose
from adr_service.methods.udr import UdrSettings, random_bounds
from adr_service.parameters import ParameterSpace
from adr_service.randomness import stream
from tests.planted import SPACE


def test_every_point_of_the_cube_is_a_valid_distribution_with_one_encoding():
    for point in np.random.default_rng(0).random((200, 8)):
        box = decode(SPACE, point)
        assert np.all(SPACE.low <= box.low)
        assert np.all(box.high <= SPACE.high)
        np.testing.assert_allclose(encode(box), point, atol=1e-9)


def test_the_corner_of_the_cube_is_the_whole_search_box():
    whole = decode(SPACE, np.ones(8))
    np.testing.assert_allclose([whole.low, whole.high], [SPACE.low, SPACE.high])
    assert np.all(np.isfinite(encode(whole)))


def test_a_point_at_the_upper_end_is_a_box_to_rounding():
    """low + (high - low) is above high, for some bounds, by the last digit."""
    ends = np.concatenate([np.ones(4), np.zeros(4)])
    rng = np.random.default_rng(0)
    for _ in range(200):
        low, high = np.sort(rng.uniform(0, 4, (2, 4)), axis=0)
        parameters = [
            replace(each, low=a, high=b, feasible_low=0.0)
            for each, a, b in zip(SPACE.parameters, low, high, strict=True)
        ]
        box = decode(ParameterSpace(tuple(parameters)), ends)
        np.testing.assert_array_equal(box.low, box.high)


def test_a_whole_interval_is_encoded_in_the_middle_of_its_room():
    whole = Uniform(SPACE, SPACE.low, SPACE.high)
    np.testing.assert_array_equal(encode(whole), [0.5] * 4 + [1.0] * 4)
    shy = Uniform(SPACE, np.nextafter(SPACE.low, np.inf), np.nextafter(SPACE.high, -np.inf))
    np.testing.assert_array_equal(encode(shy)[:4], [0.5] * 4)


def test_a_known_value_has_no_width():
    middle = (SPACE.low + SPACE.high) / 2
    np.testing.assert_allclose(encode(Uniform.point(SPACE, middle)), [0.5] * 4 + [0.0] * 4)


class TestProposals:
    boxes = random_bounds(SPACE, UdrSettings(policies=4), stream("a"))

    def test_equal_streams_propose_the_same_and_leave_torchs_generator_alone(self):
        torch.manual_seed(3)
        before = torch.rand(1)
        torch.manual_seed(3)
        first = propose(self.boxes, np.arange(4.0), stream("same"))
        assert torch.rand(1) == before
        again = propose(self.boxes, np.arange(4.0), stream("same"))
        assert first.next.to_json() == again.next.to_json()

    def test_a_proposal_lies_inside_the_search_box(self):
        proposal = propose(self.boxes, np.arange(4.0), stream("inside"))
        assert np.all(SPACE.low <= proposal.next.low)
        assert np.all(proposal.next.high <= SPACE.high)

    def test_the_best_has_the_highest_posterior_mean(self):
        proposal = propose(self.boxes, np.array([0.0, 5.0, 1.0, 2.0]), stream("best"))
        means = proposal.diagnostics["posterior_means"]
        assert len(means) == 4
        assert proposal.best == np.argmax(means) == 1

    @pytest.mark.parametrize("change", ["shift", "scale"])
    def test_the_unit_of_returns_does_not_change_the_best(self, change):
        """Returns are standardised, so a shift or a scale leaves the posterior as it was."""
        returns = np.array([0.0, 5.0, 1.0, 2.0])
        other = returns + 100 if change == "shift" else 10 * returns
        one, two = (propose(self.boxes, each, stream("unit")) for each in (returns, other))
        means = [np.array(each.diagnostics["posterior_means"]) for each in (one, two)]
        back = means[1] - 100 if change == "shift" else means[1] / 10
        np.testing.assert_allclose(back, means[0], atol=0.05)
        assert two.best == one.best

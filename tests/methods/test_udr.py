"""Random bounds of uniform domain randomization, and the whole box."""

import numpy as np
import pytest

from adr_service.distributions import Uniform
from adr_service.methods.udr import FixedDrSettings, UdrSettings, random_bounds
from adr_service.randomness import stream
from tests.planted import PROBLEM, SPACE


def test_bounds_are_ordered_and_inside_the_search_box():
    boxes = random_bounds(SPACE, UdrSettings(policies=50), stream("a"))
    assert len(boxes) == 50
    for box in boxes:
        assert isinstance(box, Uniform)
        assert np.all(box.low >= SPACE.low)
        assert np.all(box.low <= box.high)
        assert np.all(box.high <= SPACE.high)


def test_equal_streams_give_equal_bounds_and_others_differ():
    settings = UdrSettings(policies=3)
    first, again, other = (
        [box.to_json() for box in random_bounds(SPACE, settings, stream(name))]
        for name in ("a", "a", "b")
    )
    assert first == again
    assert first != other


def test_fewer_policies_are_the_first_of_more():
    few, many = (random_bounds(SPACE, UdrSettings(policies=n), stream("a")) for n in (2, 6))
    assert [box.to_json() for box in few] == [box.to_json() for box in many[:2]]


def test_sorted_uniform_draws_are_a_third_of_the_range_apart_on_average():
    """The mean distance of two uniform draws is 1/3; its standard error here is below .006."""
    boxes = random_bounds(SPACE, UdrSettings(policies=1000), stream("a"))
    widths = np.array([box.high - box.low for box in boxes]) / (SPACE.high - SPACE.low)
    assert np.mean(widths) == pytest.approx(1 / 3, abs=0.02)


def test_the_whole_box_is_drawn_from_whatever_the_returns_are():
    curriculum = FixedDrSettings().create(PROBLEM)
    for earned in (0.0, 1e6):
        values = curriculum.sample(4000, np.random.default_rng(0)).values
        share = (values - SPACE.low) / (SPACE.high - SPACE.low)
        assert share.min() < 0.01
        assert share.max() > 0.99
        np.testing.assert_allclose(share.mean(axis=0), 0.5, atol=0.02)
        curriculum.move(values, np.full(4000, earned))

"""Steps of values to their bounds, and shorter ones."""

import numpy as np
import pytest

from adr_service.criticism.bounded_steps import Bounds, shorter


def bounds_of(low, high, positive):
    return Bounds(*(np.array(each) for each in (low, high, positive)))


@pytest.mark.parametrize("low", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(20))
def test_a_step_beyond_a_bound_ends_there_to_the_last_bit(low, seed):
    """A value that rounding left just before it would not be held."""
    start, high = np.sort(np.random.default_rng(seed).uniform(0.05, 3.0, 2))
    bounds = bounds_of([low, -np.inf], [high, np.inf], [low > 0, False])
    for step, end in ((100.0, high), (-100.0, low)):
        values = np.array([start, 1.0])
        for _ in range(5):  # by a factor of e² at most
            within = bounds.limited(values, np.array([step, 7.0]))
            assert within[1] == 7.0
            values = bounds.moved(values, within)
        assert values[0] == end
        assert values[1] == 36.0


def test_a_positive_value_moves_in_proportion_and_others_by_sums():
    bounds = bounds_of([0.1, 0.0], [9.0, 9.0], [True, False])
    after = bounds.moved(np.array([2.0, 2.0]), np.array([1.0, 1.0]))
    np.testing.assert_allclose(after, [2 * np.exp(0.5), 3.0])


def test_a_value_with_a_least_one_alone_has_no_end_above():
    bounds = bounds_of([0.5], [np.inf], [False])
    for step, end in ((-3.0, 0.5), (1e9, 1e9 + 2.0)):
        assert (
            bounds.moved(np.array([2.0]), bounds.limited(np.array([2.0]), np.array([step]))) == end
        )


def test_only_a_value_at_a_bound_leaves_it():
    bounds = bounds_of([0.0, 0.0, 0.0, -np.inf], [1.0, 1.0, np.inf, np.inf], [False] * 4)
    values = np.array([0.0, 1.0, 0.0, 5.0])
    nowhere = np.zeros(4, dtype=bool)
    down, up = (bounds.leaving(values, np.full(4, step), nowhere) for step in (-1.0, 1.0))
    assert down.tolist() == [True, False, True, False]
    assert up.tolist() == [False, True, False, False]


def test_a_value_near_a_bound_leaves_it_by_a_step_beyond_it():
    bounds = bounds_of([0.0], [np.inf], [False])
    for step, is_near, leaves in ((-1.0, True, True), (-0.1, True, False), (-1.0, False, False)):
        found = bounds.leaving(np.array([0.5]), np.array([step]), np.array([is_near]))
        assert found.tolist() == [leaves]


def test_a_refused_step_is_shortened_as_a_whole_and_then_halved():
    step, within = np.array([10.0, -40.0, 3.0]), np.array([5.0, -2.0, 3.0])
    short = shorter(step, within)
    np.testing.assert_allclose(short, step / 20)
    np.testing.assert_allclose(shorter(short, short * (1 - 1e-12)), step / 40)
    np.testing.assert_allclose(shorter(step, np.array([0.0, -40.0, 3.0])), step / 2)

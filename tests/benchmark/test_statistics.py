"""Aggregates of returns and their intervals over seeds, policies and episodes."""

import numpy as np
import pytest

from adr_service.benchmark.statistics import improvement, interquartile_mean, interval, mean
from adr_service.errors import InvalidInput
from adr_service.randomness import stream


def test_the_mean_weighs_seeds_equally():
    seeds = [np.array([[1.0, 3.0]]), np.array([[10.0] * 8])]
    assert interval(seeds, mean, stream("a")).value == pytest.approx(6.0)


def test_the_interquartile_mean_is_the_mean_of_the_middle_half():
    scores = [np.array([[s] * 3]) for s in (-100.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 900.0)]
    estimate = interval(scores, interquartile_mean, stream("a"))
    assert estimate.value == pytest.approx(3.5)
    assert estimate.low <= 3.5 <= estimate.high


def test_the_probability_of_improvement_counts_pairs_and_half_of_ties():
    one = [np.array([[1.0, 1.0]]), np.array([[3.0, 3.0]])]
    other = [np.array([[1.0, 1.0]]), np.array([[2.0, 2.0]])]
    # 1 = 1, 1 < 2, 3 > 1, 3 > 2
    assert improvement(one, other, stream("a")).value == pytest.approx((0.5 + 0 + 1 + 1) / 4)
    assert improvement(one, one, stream("a")).value == pytest.approx(0.5)
    better = [returns + 10 for returns in one]
    certain = improvement(better, one, stream("a"))
    assert (certain.low, certain.value, certain.high) == (1, 1, 1)


def test_seeds_with_different_numbers_of_policies_are_refused():
    with pytest.raises(InvalidInput, match=r"differ in policies: \[1, 2\]"):
        interval([np.ones((1, 3)), np.ones((2, 3))], mean, stream("a"))


def test_equal_returns_have_an_interval_of_zero_width():
    estimate = interval([np.full((2, 5), 1.5)] * 3, mean, stream("a"))
    assert (estimate.low, estimate.value, estimate.high) == (1.5, 1.5, 1.5)


def test_the_interval_covers_the_truth_about_as_often_as_it_states():
    """Normal seeds and episodes, 20 seeds; the percentile bootstrap is a little short."""
    rng, covered = np.random.default_rng(0), 0
    for _ in range(100):
        seeds = [rng.normal(rng.normal(0, 1), 1, (1, 20)) for _ in range(20)]
        estimate = interval(seeds, mean, rng)
        covered += estimate.low <= 0 <= estimate.high
    assert 85 <= covered <= 99


def test_an_interval_repeats_with_its_stream():
    seeds = [np.random.default_rng(i).normal(size=(1, 9)) for i in range(3)]
    first, again, other = (interval(seeds, mean, stream("a", i)) for i in (1, 1, 2))
    assert first == again != other


@pytest.mark.parametrize("seeds", [[], [np.empty((1, 0))]])
def test_an_interval_of_no_returns_is_refused(seeds):
    with pytest.raises(InvalidInput):
        interval(seeds, mean, stream("a"))

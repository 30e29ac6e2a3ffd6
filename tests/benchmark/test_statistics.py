"""Aggregates of returns and their intervals over seeds, policies and episodes."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import binom

from adr_service.benchmark.statistics import (
    Interval,
    bootstrap_interval,
    improvement,
    interquartile_mean,
    mean_interval,
    seed_interval,
    stratified_intervals,
)
from adr_service.errors import InvalidInput
from adr_service.randomness import stream


def test_the_mean_weighs_seeds_equally():
    seeds = [np.array([[1.0, 3.0]]), np.array([[10.0] * 8])]
    assert mean_interval(seeds).value == pytest.approx(6.0)


def test_the_interval_of_a_mean_is_students():
    """Three values: the 97.5 % quantile with two degrees of freedom has a closed form."""
    estimate = seed_interval(np.array([1.0, 2.0, 3.0]))
    quantile = 2 * 0.475 * np.sqrt(2 / (1 - (2 * 0.475) ** 2))
    reach = quantile / np.sqrt(3)  # the standard error of 1, 2 and 3
    assert (estimate.low, estimate.high) == pytest.approx((2 - reach, 2 + reach))
    assert str(Interval(1.0, 0.5, 1.5)) == "1.00 [0.50, 1.50]"


@pytest.mark.parametrize("count", [1, 2])
def test_fewer_than_three_seeds_have_no_interval(count):
    returns = [np.array([[1.0, 3.0]])] * count
    assert mean_interval(returns) == Interval(2.0, None, None)
    assert bootstrap_interval(returns, interquartile_mean, stream("a")).low is None
    assert improvement(returns, returns, stream("a")).low is None
    assert str(mean_interval(returns)) == "2.00"


def test_students_interval_covers_the_truth_as_often_as_it_states():
    rng = np.random.default_rng(0)
    for count in (3, 5):
        estimates = [seed_interval(rng.normal(size=count)) for _ in range(2000)]
        covered = np.mean([e.low <= 0 <= e.high for e in estimates])
        assert 0.93 < covered < 0.97


def test_the_interquartile_mean_is_the_mean_of_the_middle_half():
    scores = [np.array([[s] * 3]) for s in (-100.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 900.0)]
    estimate = bootstrap_interval(scores, interquartile_mean, stream("a"))
    assert estimate.value == pytest.approx(3.5)
    assert estimate.low <= 3.5 <= estimate.high


def test_a_bootstrap_draws_seeds_and_has_the_middle_95_percent():
    """All resamples of four seeds, whose episodes are equal, are known."""
    earned = np.array([0.0, 1.0, 5.0, 9.0])
    seeds = [np.full((1, 3), each) for each in earned]
    found = bootstrap_interval(seeds, lambda scores: np.mean(scores, axis=-1), stream("a"))
    every = np.mean(list(product(earned, repeat=4)), axis=1)
    assert len(every) == 256
    for bound, share in ((found.low, 0.025), (found.high, 0.975)):
        assert np.quantile(every, share - 0.01) <= bound <= np.quantile(every, share + 0.01)
    assert found.value == pytest.approx(3.75)


def test_a_bootstrap_draws_episodes_within_seeds():
    """Twelve episodes that earn 0 or 1 are a binomial."""
    seeds = [np.array([[0.0, 1.0, 0.0, 1.0]])] * 3
    found = bootstrap_interval(seeds, lambda scores: np.mean(scores, axis=-1), stream("a"))
    expected = binom.ppf([0.025, 0.975], 12, 0.5) / 12
    assert (found.low, found.high) == pytest.approx(expected)


def test_a_bootstrap_draws_policies_within_seeds():
    seeds = [np.repeat([[0.0], [1.0]], 5, axis=1)] * 3
    found = bootstrap_interval(seeds, lambda scores: np.mean(scores, axis=-1), stream("a"))
    expected = binom.ppf([0.025, 0.975], 6, 0.5) / 6
    assert (found.low, found.high) == pytest.approx(expected)


def test_the_probability_of_improvement_counts_pairs_and_half_of_ties():
    one = [np.array([[1.0, 1.0]]), np.array([[3.0, 3.0]])]
    other = [np.array([[1.0, 1.0]]), np.array([[2.0, 2.0]])]
    # 1 = 1, 1 < 2, 3 > 1, 3 > 2
    assert improvement(one, other, stream("a")).value == pytest.approx((0.5 + 0 + 1 + 1) / 4)
    assert improvement(one, one, stream("a")).value == pytest.approx(0.5)
    better = [returns + 10 for returns in one * 3]
    assert improvement(better[:4], one * 3, stream("a")).low is None
    certain = improvement(better, one * 3, stream("a"))
    assert (certain.low, certain.value, certain.high) == (1, 1, 1)


def test_two_methods_with_the_same_policies_are_equal_for_certain():
    returns = [np.random.default_rng(seed).normal(seed, size=(1, 9)) for seed in range(5)]
    apart = improvement(returns, returns, stream("a"))
    assert apart.value == 0.5
    assert apart.low < 0.2
    assert apart.high > 0.8
    same = improvement(returns, returns, stream("a"), policies=("a b c", "a b c"))
    assert (same.low, same.value, same.high) == (0.5, 0.5, 0.5)
    assert improvement(returns, returns, stream("a"), policies=("a b c", "d e f")) == apart


def test_cells_of_the_same_policies_are_drawn_alike():
    """Twice the same numbers say no more than once."""
    returns = [np.random.default_rng(seed).normal(seed, size=(2, 9)) for seed in range(3)]

    def interval(cells, **policies):
        aggregates = [lambda scores: scores.mean(axis=-1)]
        return stratified_intervals(cells, aggregates, stream("a"), **policies)[0]

    once = interval([returns])
    twice = interval([returns, returns], policies=["a", "a"])
    assert (twice.low, twice.high) == pytest.approx((once.low, once.high))
    apart = interval([returns, returns], policies=["a", "b"])
    assert apart == interval([returns, returns])
    assert apart.high - apart.low < 0.8 * (once.high - once.low)


def test_seeds_with_different_numbers_of_policies_are_refused():
    with pytest.raises(InvalidInput, match=r"differ in policies: \[1, 2\]"):
        bootstrap_interval([np.ones((1, 3)), np.ones((2, 3))], interquartile_mean, stream("a"))


def test_equal_returns_have_an_interval_of_zero_width():
    returns = [np.full((2, 5), 1.5)] * 3
    for estimate in (
        mean_interval(returns),
        bootstrap_interval(returns, interquartile_mean, stream("a")),
    ):
        assert (estimate.low, estimate.value, estimate.high) == (1.5, 1.5, 1.5)


def test_a_bootstrap_repeats_with_its_stream():
    seeds = [np.random.default_rng(i).normal(size=(1, 9)) for i in range(3)]
    first, again, other = (
        bootstrap_interval(seeds, interquartile_mean, stream("a", i)) for i in (1, 1, 2)
    )
    assert first == again != other


@pytest.mark.parametrize("seeds", [[], [np.empty((1, 0))]])
def test_an_interval_of_no_returns_is_refused(seeds):
    with pytest.raises(InvalidInput):
        bootstrap_interval(seeds, interquartile_mean, stream("a"))
    with pytest.raises(InvalidInput):
        mean_interval(seeds)

import numpy as np
import pytest

from adr_service.benchmark.statistics import mean_interval
from adr_service.errors import InvalidInput
from adr_service.randomness import integer_seed, stream


def test_the_mean_weighs_seeds_equally():
    seeds = [np.array([[1.0, 3.0]]), np.array([[10.0] * 8])]
    assert mean_interval(seeds, stream("a")).mean == pytest.approx(6.0)


def test_equal_returns_have_no_width():
    interval = mean_interval([np.full((2, 5), 1.5)] * 3, stream("a"))
    assert (interval.low, interval.mean, interval.high) == (1.5, 1.5, 1.5)


def test_it_covers_the_truth_about_as_often_as_it_says():
    """Normal seeds and episodes, 20 seeds; the percentile bootstrap is a little short."""
    rng, covered = np.random.default_rng(0), 0
    for _ in range(100):
        seeds = [rng.normal(rng.normal(0, 1), 1, (1, 20)) for _ in range(20)]
        interval = mean_interval(seeds, rng)
        covered += interval.low <= 0 <= interval.high
    assert 85 <= covered <= 99


def test_it_repeats_with_its_stream():
    seeds = [np.random.default_rng(i).normal(size=(1, 9)) for i in range(3)]
    assert mean_interval(seeds, stream("a", 1)) == mean_interval(seeds, stream("a", 1))
    assert mean_interval(seeds, stream("a", 1)) != mean_interval(seeds, stream("a", 2))


@pytest.mark.parametrize("seeds", [[], [np.empty((1, 0))]])
def test_no_returns_have_no_interval(seeds):
    with pytest.raises(InvalidInput):
        mean_interval(seeds, stream("a"))


def test_streams_are_told_apart_by_their_whole_path():
    paths = [("a",), ("b",), ("a", "b"), ("ab",), ("a", 1), ("a", 11), ("a", 1, 1)]
    firsts = {stream(*path).random() for path in paths}
    assert len(firsts) == len(paths)
    assert 0 < integer_seed(stream("a")) < 2**31

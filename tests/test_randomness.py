"""Named random streams."""

import numpy as np
import pytest

from adr_service.randomness import integer_seed, stream

FIRST_OF_A, SEED_OF_A = 0.14060878940268373, 31521243


def test_streams_with_different_paths_give_different_numbers():
    paths = [("a",), ("b",), ("a", "b"), ("ab",), ("a", 1), ("a", 11), ("a", 1, 1)]
    firsts = {stream(*path).random() for path in paths}
    assert len(firsts) == len(paths)


def test_a_stream_repeats_whatever_was_drawn_elsewhere():
    first = stream("a", 3).random(5)
    stream("b").random(100)
    np.testing.assert_array_equal(stream("a", 3).random(5), first)


def test_the_numbers_of_a_stream_stay_those_of_earlier_versions():
    """Seeded results are stored: these two were drawn by version 0.1.0."""
    assert stream("a").random() == pytest.approx(FIRST_OF_A, abs=0)
    assert integer_seed(stream("a")) == SEED_OF_A


def test_an_integer_seed_fits_into_31_bits():
    assert all(0 < integer_seed(stream("seed", i)) < 2**31 for i in range(1000))

"""CMA-ES: it finds a minimum, repeats with its stream, and knows what it samples from."""

import numpy as np
import pytest

from adr_service.randomness import stream
from adr_service.search.cma_es import belief, strategy


def minimised(rng, target, iterations=60):
    """The search after some iterations on a quadratic with its minimum at `target`."""
    es = strategy(np.full(len(target), 2.0), std=1.0, width=4.0, rng=rng)
    for _ in range(iterations):
        candidates = es.ask()
        assert all(np.all((x >= 0) & (x <= 4)) for x in candidates)
        es.tell(candidates, [float(np.sum((x - target) ** 2)) for x in candidates])
    return es


@pytest.mark.parametrize("target", [[1.0, 3.0, 2.5], [0.0, 4.0, 2.0]], ids=["inside", "at bounds"])
def test_the_minimum_of_a_quadratic_is_recovered(target):
    mean, covariance = belief(minimised(stream("cma"), np.array(target)))
    np.testing.assert_allclose(mean, target, atol=0.01)
    assert np.all(np.sqrt(np.diag(covariance)) < 0.1)


def test_the_same_stream_gives_the_same_search():
    target = np.array([1.0, 3.0])
    first, again, other = (minimised(stream("cma", i), target, 5).ask() for i in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert np.any(np.array(first) != np.array(other))


def test_numpys_global_generator_is_left_alone():
    np.random.seed(7)  # noqa: NPY002
    expected = np.random.random()  # noqa: NPY002
    np.random.seed(7)  # noqa: NPY002
    minimised(stream("cma"), np.array([1.0, 3.0]), 2)
    assert np.random.random() == expected  # noqa: NPY002


def test_the_belief_is_the_gaussian_that_the_search_samples_from():
    es = strategy(np.full(3, 2.0), std=0.05, width=4.0, rng=stream("cma"))
    for _ in range(5):
        candidates = es.ask()
        es.tell(candidates, [float(np.sum((x - 2.1) ** 2 * (1, 9, 25))) for x in candidates])
    mean, covariance = belief(es)
    sampled = np.array(es.ask(20_000))
    np.testing.assert_allclose(sampled.mean(axis=0), mean, atol=0.003)
    np.testing.assert_allclose(np.cov(sampled.T), covariance, rtol=0.1, atol=2e-4)

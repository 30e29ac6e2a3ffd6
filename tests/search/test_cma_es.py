"""CMA-ES over a box, and the Gaussian of its search."""

import numpy as np
import pytest

from adr_service.randomness import stream
from adr_service.search.cma_es import belief, strategy

WEIGHTS = np.array([1.0, 9.0, 25.0])


def searched(name="cma", generations=5, optimum=2.1):
    """A search after some generations on a quadratic."""
    es = strategy(np.full(3, 2.0), std=0.05, width=4.0, rng=stream(name))
    for _ in range(generations):
        candidates = es.ask()
        es.tell(candidates, [float(np.sum((x - optimum) ** 2 * WEIGHTS)) for x in candidates])
    return es


def test_the_belief_is_the_gaussian_that_the_search_samples_from():
    es = searched()
    mean, covariance = belief(es)
    sampled = np.array(es.ask(20_000))
    np.testing.assert_allclose(sampled.mean(axis=0), mean, atol=0.003)
    np.testing.assert_allclose(np.cov(sampled.T), covariance, rtol=0.1, atol=2e-4)


def test_the_belief_before_any_candidate_is_the_start():
    es = strategy(np.full(3, 2.0), std=0.05, width=4.0, rng=stream("start"))
    mean, covariance = belief(es)
    np.testing.assert_allclose(mean, 2.0)
    # pycma makes equal axes slightly unequal
    np.testing.assert_allclose(covariance, 0.05**2 * np.eye(3), rtol=1e-4)


def test_equal_streams_search_equally_whatever_the_global_generator_is():
    means = []
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002
        means.append(belief(searched())[0])
    np.testing.assert_array_equal(*means)
    assert np.any(belief(searched("other"))[0] != means[0])


def test_the_global_generator_is_left_alone():
    np.random.seed(1)  # noqa: NPY002
    before = np.random.random()  # noqa: NPY002
    np.random.seed(1)  # noqa: NPY002
    searched()
    assert np.random.random() == before  # noqa: NPY002


def test_pycmas_file_of_signals_in_the_working_directory_is_not_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cma_signals.in").write_text("{'maxiter': 1}")
    assert searched().stop() == {}


@pytest.mark.parametrize("optimum", [-1.0, 5.0])
def test_candidates_stay_inside_the_box_when_the_optimum_is_outside(optimum):
    candidates = np.array(searched(generations=60, optimum=optimum).ask(100))
    assert np.all(candidates >= 0)
    assert np.all(candidates <= 4)

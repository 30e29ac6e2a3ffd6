import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from adr_service.benchmark.truth import energy_score, estimation_error, log_score, true_values
from adr_service.distributions import Gaussian, TruncatedGaussian, Uniform
from adr_service.tasks.catalogue import catalogue, variant_of

CASES = [(task, variant) for task, entry in catalogue().items() for variant in entry.variants]


@pytest.mark.parametrize(("task", "variant"), CASES)
def test_the_truth_is_no_distance_from_itself(task, variant):
    pair = variant_of(task, variant)
    assert estimation_error(task, variant, pair.truth) == 0
    known = true_values(task, variant)
    assert [known[name] for name in pair.source.space.names] == pair.truth.tolist()


def test_the_distance_is_the_root_mean_square_over_parameters():
    pair = variant_of("arm", "vanilla")
    space = pair.source.space
    moved = space.denormalise(space.normalise(pair.truth) + np.array([2.0, 0, 0, 0]))
    assert estimation_error("arm", "vanilla", moved) == pytest.approx(1.0)


def beliefs(deviation, offset=0.0):
    """A Gaussian about the truth of the arm, moved by `offset`, all in [0, 4]."""
    pair = variant_of("arm", "vanilla")
    space = pair.source.space
    location = space.normalise(pair.truth) + offset
    return Gaussian(space, location, deviation**2 * np.eye(len(space)))


def test_the_log_score_is_the_log_density_of_the_truth():
    pair = variant_of("arm", "vanilla")
    belief = beliefs(0.5, 0.3)
    expected = multivariate_normal(belief.mean, np.diag(belief.std**2)).logpdf(pair.truth)
    assert log_score("arm", "vanilla", belief) == pytest.approx(expected)
    assert log_score("arm", "vanilla", Uniform.point(pair.source.space, pair.truth)) is None


def test_the_log_score_of_a_cut_belief_is_that_of_the_whole():
    """DROPO never draws this truth, and its own density of it is zero."""
    pair = variant_of("arm", "vanilla")
    space, truth = pair.source.space, pair.truth
    std = np.full(len(space), 0.01)
    belief = TruncatedGaussian(space, truth + 3 * std, std)
    assert np.isneginf(belief.log_prob(truth[None])[0])
    expected = norm.logpdf(3, scale=1).item() - np.log(0.01)
    assert log_score("arm", "vanilla", belief) == pytest.approx(len(space) * expected)


def test_a_points_energy_score_is_its_distance():
    pair = variant_of("arm", "vanilla")
    space = pair.source.space
    moved = space.denormalise(space.normalise(pair.truth) + 0.7)
    score = energy_score("arm", "vanilla", Uniform.point(space, moved))
    assert score == pytest.approx(estimation_error("arm", "vanilla", moved)) == pytest.approx(0.7)


def test_the_energy_score_prefers_a_belief_as_wide_as_its_error():
    right, narrow, wide = (
        energy_score("arm", "vanilla", beliefs(deviation, 0.5)) for deviation in (0.5, 0.01, 2.0)
    )
    assert right < narrow
    assert right < wide
    assert energy_score("arm", "vanilla", beliefs(1e-6)) < 1e-5

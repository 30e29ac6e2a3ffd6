"""Formulas of each distribution, and beliefs that are refused."""

import numpy as np
import pytest
from scipy import stats

from adr_service.distributions import (
    Beta,
    Empirical,
    Gaussian,
    Mixture,
    TruncatedGaussian,
    Uniform,
    at_resolution,
    distribution_from_json,
)
from adr_service.errors import InfeasibleDistribution, InvalidInput, UnknownName
from adr_service.parameters import Parameter, ParameterSpace
from adr_service.tasks.catalogue import source_of

SPACE = ParameterSpace(
    (
        Parameter("a", "body:a.mass", "kg", 0.5, 10.0, 0.1),
        Parameter("b", "body:b.mass", "kg", 1.0, 3.0, 0.1),
    )
)


def test_gaussian_draws_are_clipped_to_the_box_and_counted():
    prior = Gaussian.prior(SPACE)
    draws = prior.sample(20_000, np.random.default_rng(1))
    assert np.all((draws.values >= SPACE.low) & (draws.values <= SPACE.high))
    outside = 1 - (1 - 2 * stats.norm.cdf(-2)) ** 2  # a coordinate beyond two deviations
    assert draws.adjusted / 20_000 == pytest.approx(outside, abs=4 * np.sqrt(outside / 20_000))


def test_truncated_draws_follow_scipys_truncated_normal():
    low = (0.1 - 1.0) / 0.8  # the feasible bound, in deviations: above -2
    belief = TruncatedGaussian(SPACE, np.array([1.0, 2.0]), np.array([0.8, 0.1]))
    draws = belief.sample(5000, np.random.default_rng(2)).values[:, 0]
    reference = stats.truncnorm(low, 2, loc=1.0, scale=0.8)
    assert stats.kstest(draws, reference.cdf).pvalue > 1e-3


def test_a_distribution_without_feasible_draws_is_refused():
    with pytest.raises(InfeasibleDistribution, match="feasible"):
        TruncatedGaussian(SPACE, np.array([-5.0, 2.0]), np.array([0.1, 0.1]))
    with pytest.raises(InfeasibleDistribution, match="feasible"):
        Uniform(SPACE, np.array([0.0, 1.0]), np.array([2.0, 2.0]))
    with pytest.raises(InfeasibleDistribution, match="below the feasible"):
        Empirical.equal(SPACE, np.zeros((2, 2)))


@pytest.mark.parametrize("bad", [[1.0], [1.0, np.nan], [[1.0, 2.0]]])
def test_a_mean_of_the_wrong_shape_or_not_finite_is_refused(bad):
    with pytest.raises(InvalidInput, match="2 finite values"):
        TruncatedGaussian(SPACE, bad, np.array([1.0, 1.0]))


@pytest.mark.parametrize(
    "covariance",
    [
        np.eye(3),
        [[1, 2], [2, 1]],
        [[np.nan, 0], [0, 1]],
        [[1, 0.9], [0, 1]],  # NumPy would read the lower triangle alone
        [[1, 0], [0]],
    ],
)
def test_an_impossible_covariance_is_refused(covariance):
    with pytest.raises(InvalidInput, match="covariance"):
        Gaussian(SPACE, np.array([2.0, 2.0]), covariance)


def test_a_covariance_that_rounding_makes_indefinite_is_accepted():
    covariance = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-15]])
    assert np.linalg.eigvalsh(covariance)[0] < 0
    draws = Gaussian(SPACE, np.array([2.0, 2.0]), covariance).sample(20, np.random.default_rng(0))
    np.testing.assert_allclose(*SPACE.normalise(draws.values).T, atol=1e-6)


def test_an_unknown_kind_is_refused():
    with pytest.raises(UnknownName, match="uniform, gaussian, truncated_gaussian"):
        distribution_from_json(SPACE, {"kind": "cauchy"})


def test_a_missing_field_is_named():
    with pytest.raises(InvalidInput, match=r"needs low, high; not given: \['high'\]"):
        distribution_from_json(SPACE, {"kind": "uniform", "low": [1.0, 1.0]})


def test_a_field_that_the_kind_does_not_have_is_refused():
    given = {"kind": "uniform", "low": [1.0, 1.0], "high": [2.0, 2.0], "hgih": [3.0, 3.0]}
    with pytest.raises(InvalidInput, match=r"has low, high; given \['hgih'\] too"):
        distribution_from_json(SPACE, given)


@pytest.mark.parametrize("low", [["1", "1"], [True, True]])
def test_texts_and_booleans_are_refused_as_numbers(low):
    with pytest.raises(InvalidInput, match="low must be numbers"):
        distribution_from_json(SPACE, {"kind": "uniform", "low": low, "high": [2.0, 2.0]})


def test_the_prior_is_two_and_one_in_the_normalised_coordinates():
    prior = Gaussian.prior(SPACE)
    np.testing.assert_allclose(SPACE.normalise(prior.mean), 2.0)
    np.testing.assert_allclose(4 * prior.std / (SPACE.high - SPACE.low), 1.0)


def test_a_point_has_all_its_density_at_its_values():
    point = Uniform.point(SPACE, np.array([1.0, 1.5]))
    assert point.log_prob(np.array([[1.0, 1.5], [1.0, 1.6]])).tolist() == [np.inf, -np.inf]
    assert not point.std.any()


def test_a_gaussians_density_is_scipys_in_si_units():
    belief = Gaussian(SPACE, np.array([1.0, 2.0]), np.array([[0.5, 0.2], [0.2, 0.3]]))
    scale = np.diag((SPACE.high - SPACE.low) / 4)
    reference = stats.multivariate_normal(belief.mean, scale @ belief.covariance @ scale)
    draws = belief.sample(20, np.random.default_rng(0)).values
    np.testing.assert_allclose(belief.log_prob(draws), reference.logpdf(draws))


def test_a_narrow_direction_counts_in_a_gaussians_density():
    """SciPy's function leaves out deviations below 1.5e-5 of the largest."""
    axes, deviations = np.array([[0.8, -0.6], [0.6, 0.8]]), np.array([1.0, 1e-6])
    belief = Gaussian(SPACE, np.array([2.0, 2.0]), (axes * deviations**2) @ axes.T)
    away = np.array([[0.0, 0.0], [0.0, 3.0], [1.0, 3.0]])  # in deviations
    values = SPACE.denormalise(2.0 + (away * deviations) @ axes.T)
    expected = stats.norm.logpdf(away * deviations, 0, deviations).sum(axis=1)
    expected -= np.log((SPACE.high - SPACE.low) / 4).sum()
    np.testing.assert_allclose(belief.log_prob(values), expected, atol=0.01)


def test_a_singular_gaussian_has_a_density_on_the_line_of_its_draws_alone():
    belief = Gaussian(SPACE, np.array([2.0, 2.0]), np.diag([1.0, 0.0]))
    on, off = belief.log_prob(SPACE.denormalise(np.array([[2.5, 2.0], [2.5, 2.1]])))
    assert on == pytest.approx(stats.norm.logpdf(0.5) - np.log((SPACE.high - SPACE.low) / 4).sum())
    assert off == -np.inf


def test_what_rounding_leaves_of_a_singular_direction_does_not_count():
    along = np.array([[0.8], [0.6]])
    belief = Gaussian(SPACE, np.array([2.0, 2.0]), along @ along.T + 1e-17 * np.eye(2))
    on = belief.log_prob(SPACE.denormalise(np.array([[2.4, 2.3]])))
    assert on == pytest.approx(stats.norm.logpdf(0.5) - np.log((SPACE.high - SPACE.low) / 4).sum())


def test_bounds_in_the_wrong_order_are_refused():
    with pytest.raises(InvalidInput, match="low <= high"):
        Uniform(SPACE, np.array([2.0, 2.0]), np.array([1.0, 3.0]))


def test_a_narrow_belief_is_a_point_on_a_grid_at_a_resolution():
    space = source_of("arm", "vanilla").space
    location = np.array([0.1234, 1.0, 2.006, 4.2])
    narrow = Gaussian(space, location, 0.009**2 * np.eye(4))
    point = at_resolution(narrow, 0.01)
    assert isinstance(point, Uniform)
    np.testing.assert_array_equal(point.low, point.high)
    # the last is moved into the search box, as its draws are
    np.testing.assert_allclose(space.normalise(point.mean), [0.12, 1.0, 2.01, 4.0])
    near = Gaussian(space, location + 0.001, 0.001**2 * np.eye(4))
    assert at_resolution(near, 0.01).to_json() == point.to_json()


def test_a_belief_that_is_wide_anywhere_stays_as_it_is():
    space = source_of("arm", "vanilla").space
    deviations = np.array([1e-6, 1e-6, 1e-6, 0.011])
    wide = Gaussian(space, np.full(4, 2.003), np.diag(deviations**2))
    assert at_resolution(wide, 0.01) is wide
    prior = Gaussian.prior(space)
    assert at_resolution(prior, 0.01) is prior


def test_a_point_beyond_the_search_box_stays_beyond_it_at_a_resolution():
    point = Uniform.point(SPACE, SPACE.denormalise(np.array([4.213, -0.208])))
    moved = at_resolution(point, 0.01)
    np.testing.assert_allclose(SPACE.normalise(moved.mean), [4.21, -0.208])  # -0.21 is further


def test_a_point_at_the_feasible_bound_is_feasible_at_every_resolution():
    point = Uniform.point(SPACE, np.array([0.1, 0.1]))
    for resolution in (0.01, 0.03, 0.3, 1.0):
        moved = SPACE.normalise(at_resolution(point, resolution).mean)
        assert np.all(np.abs(moved - SPACE.normalise(point.mean)) <= resolution)


def test_a_point_in_the_search_box_stays_in_it_at_a_resolution():
    point = at_resolution(Uniform.point(SPACE, SPACE.high), 0.7)
    np.testing.assert_allclose(SPACE.normalise(point.mean), 4.0)  # the grid has 4.2


def test_a_box_keeps_its_width_at_every_resolution():
    narrow = Uniform(SPACE, np.array([1.0, 2.0]), np.array([1.0, 2.001]))
    for resolution in (0.01, 1.0):
        assert at_resolution(narrow, resolution) is narrow


def test_a_beta_with_both_shapes_one_is_the_whole_box():
    box, belief = Uniform(SPACE, SPACE.low, SPACE.high), Beta(SPACE, np.ones(2), np.ones(2))
    np.testing.assert_allclose(belief.mean, box.mean)
    np.testing.assert_allclose(belief.std, box.std)
    inside = np.array([[1.0, 1.5], [9.0, 2.9]])
    np.testing.assert_allclose(belief.log_prob(inside), box.log_prob(inside))


def test_a_mixture_of_one_gaussian_is_that_gaussian():
    location, covariance = np.array([1.5, 2.0]), np.array([[0.2, 0.1], [0.1, 0.3]])
    one = Gaussian(SPACE, location, covariance)
    mixture = Mixture(SPACE, np.ones(1), location[None], covariance[None])
    np.testing.assert_allclose(mixture.mean, one.mean)
    np.testing.assert_allclose(mixture.std, one.std)
    points = one.sample(20, np.random.default_rng(0)).values
    np.testing.assert_allclose(mixture.log_prob(points), one.log_prob(points))


def test_clipped_draws_of_a_mixture_are_counted():
    covariances = np.array([0.01 * np.eye(2), 4.0 * np.eye(2)])
    mixture = Mixture(SPACE, np.array([0.5, 0.5]), np.full((2, 2), 2.0), covariances)
    draws = mixture.sample(4000, np.random.default_rng(0))
    outside = (1 - (1 - 2 * stats.norm.cdf(-1)) ** 2) / 2  # of the wide one, drawn half the time
    assert draws.adjusted / 4000 == pytest.approx(outside, abs=4 * np.sqrt(outside / 4000))


def test_points_are_drawn_by_their_weights():
    points = np.array([[1.0, 1.5], [2.0, 2.5]])
    sample = Empirical(SPACE, points, np.array([0.2, 0.8]))
    drawn = sample.sample(5000, np.random.default_rng(0)).values
    assert np.mean(drawn[:, 0] == 2.0) == pytest.approx(0.8, abs=4 * np.sqrt(0.16 / 5000))
    np.testing.assert_allclose(Empirical.equal(SPACE, points).mean, [1.5, 2.0])


@pytest.mark.parametrize(
    ("create", "words"),
    [
        (lambda: Beta(SPACE, np.array([1.0, 0.0]), np.ones(2)), "shapes must be positive"),
        (lambda: TruncatedGaussian(SPACE, [1.0, 2.0], [0.1, 0.0]), "must be positive"),
        (lambda: Mixture(SPACE, [0.5, 0.6], np.ones((2, 2)), [np.eye(2)] * 2), "of sum 1"),
        (lambda: Mixture(SPACE, [1.0], np.ones((2, 2)), [np.eye(2)] * 2), "given .1,., .2, 2."),
        (lambda: Mixture(SPACE, [1.0], np.ones((1, 2)), [-np.eye(2)]), "semi-definite"),
        (lambda: Empirical(SPACE, np.ones((2, 3)), [0.5, 0.5]), "points .n, 2."),
        (lambda: Empirical(SPACE, np.ones((2, 2)), [1.5, -0.5]), "of sum 1"),
        (lambda: Empirical(SPACE, [[1.0, np.nan]], [1.0]), "finite"),
        (lambda: Empirical(SPACE, np.ones((2, 2)), [np.nan, 1.0]), "of sum 1; given .nan"),
        (lambda: Mixture(SPACE, [np.nan], np.ones((1, 2)), [np.eye(2)]), "of sum 1; given .nan"),
        (lambda: Empirical(SPACE, [[1.0, 2.0], [1.0]], [0.5, 0.5]), "rows of one length"),
        (lambda: Empirical(SPACE, np.ones((3, 2)), [0.333333] * 3), "of sum 1"),
        (lambda: Mixture(SPACE, "half", np.ones((1, 2)), [np.eye(2)]), "weights must be numbers"),
    ],
)
def test_impossible_distributions_are_refused(create, words):
    with pytest.raises(InvalidInput, match=words):
        create()

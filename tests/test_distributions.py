import json

import numpy as np
import pytest
from scipy import integrate, stats

from adr_service.distributions import (
    Gaussian,
    TruncatedGaussian,
    Uniform,
    distribution_from_json,
)
from adr_service.errors import InfeasibleDistribution, InvalidInput, UnknownName
from adr_service.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace(
    (
        Parameter("a", "body:a.mass", "kg", 0.5, 10.0, 0.1),
        Parameter("b", "body:b.mass", "kg", 1.0, 3.0, 0.1),
    )
)
LINE = ParameterSpace(SPACE.parameters[:1])
COVARIANCE = np.array([[0.5, 0.2], [0.2, 0.3]])
MEMBERS = {
    "uniform": Uniform(SPACE, np.array([1.0, 1.5]), np.array([2.0, 2.5])),
    "point": Uniform.point(SPACE, np.array([1.0, 1.5])),
    "gaussian": Gaussian(SPACE, np.array([1.0, 2.0]), COVARIANCE),
    "prior": Gaussian.prior(SPACE),
    "truncated_gaussian": TruncatedGaussian(SPACE, np.array([1.0, 2.0]), np.array([0.8, 0.1])),
}


@pytest.fixture(params=MEMBERS)
def member(request):
    return MEMBERS[request.param]


def test_draws_are_feasible_read_only_and_repeat(member):
    draws = member.sample(500, np.random.default_rng(0)).values
    assert draws.shape == (500, 2)
    assert np.all(draws >= SPACE.feasible_low)
    assert not draws.flags.writeable
    np.testing.assert_array_equal(draws, member.sample(500, np.random.default_rng(0)).values)


def test_json_gives_the_same_distribution_back(member):
    copy = distribution_from_json(SPACE, json.loads(json.dumps(member.to_json())))
    np.testing.assert_array_equal(copy.mean, member.mean)
    np.testing.assert_array_equal(copy.std, member.std)
    assert copy.to_json() == member.to_json()


@pytest.mark.parametrize(
    "line",
    [
        Uniform(LINE, np.array([1.0]), np.array([2.0])),
        Gaussian(LINE, np.array([2.0]), np.array([[0.5]])),
        TruncatedGaussian(LINE, np.array([1.0]), np.array([0.8])),
    ],
    ids=["uniform", "gaussian", "truncated_gaussian"],
)
def test_densities_integrate_to_one(line):
    mass, _ = integrate.quad(
        lambda x: np.exp(line.log_prob(np.array([[x]]))[0]), -30, 30, points=[0.1, 1, 2, 2.6]
    )
    assert mass == pytest.approx(1, abs=1e-6)


def test_gaussian_draws_are_clipped_to_the_box_and_counted():
    prior = Gaussian.prior(SPACE)
    draws = prior.sample(20_000, np.random.default_rng(1))
    assert np.all((draws.values >= SPACE.low) & (draws.values <= SPACE.high))
    outside = 1 - (1 - 2 * stats.norm.cdf(-2)) ** 2  # a coordinate beyond two deviations
    assert draws.adjusted / 20_000 == pytest.approx(outside, abs=4 * np.sqrt(outside / 20_000))


def test_truncated_draws_follow_scipys_truncated_normal():
    low = (0.1 - 1.0) / 0.8  # the feasible bound, in deviations: above -2
    draws = MEMBERS["truncated_gaussian"].sample(5000, np.random.default_rng(2)).values[:, 0]
    reference = stats.truncnorm(low, 2, loc=1.0, scale=0.8)
    assert stats.kstest(draws, reference.cdf).pvalue > 1e-3


def test_a_distribution_without_feasible_draws_is_refused():
    with pytest.raises(InfeasibleDistribution, match="feasible"):
        TruncatedGaussian(SPACE, np.array([-5.0, 2.0]), np.array([0.1, 0.1]))
    with pytest.raises(InfeasibleDistribution, match="feasible"):
        Uniform(SPACE, np.array([0.0, 1.0]), np.array([2.0, 2.0]))


@pytest.mark.parametrize("bad", [[1.0], [1.0, np.nan], [[1.0, 2.0]]])
def test_a_mean_of_the_wrong_shape_or_not_finite_is_refused(bad):
    with pytest.raises(InvalidInput, match="2 finite values"):
        TruncatedGaussian(SPACE, bad, np.array([1.0, 1.0]))


@pytest.mark.parametrize("covariance", [np.eye(3), [[1, 2], [2, 1]], [[np.nan, 0], [0, 1]]])
def test_an_impossible_covariance_is_refused(covariance):
    with pytest.raises(InvalidInput, match="covariance"):
        Gaussian(SPACE, np.array([2.0, 2.0]), covariance)


def test_an_unknown_kind_is_refused():
    with pytest.raises(UnknownName, match="uniform, gaussian, truncated_gaussian"):
        distribution_from_json(SPACE, {"kind": "beta"})


def test_a_missing_field_is_named():
    with pytest.raises(InvalidInput, match=r"needs low, high; not given: \['high'\]"):
        distribution_from_json(SPACE, {"kind": "uniform", "low": [1.0, 1.0]})

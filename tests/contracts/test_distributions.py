"""The contract of every distribution: JSON, feasible draws, moments and densities."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate

from adr_service.distributions import (
    KINDS,
    Beta,
    Empirical,
    Gaussian,
    Mixture,
    TruncatedGaussian,
    Uniform,
    distribution_from_json,
)
from adr_service.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace(
    (
        Parameter("a", "body:a.mass", "kg", 0.5, 10.0, 0.1),
        Parameter("b", "body:b.mass", "kg", 1.0, 3.0, 0.1),
    )
)
LINE = ParameterSpace(SPACE.parameters[:1])
COVARIANCE = np.array([[0.5, 0.2], [0.2, 0.3]])
WEIGHTS = np.array([0.3, 0.7])
MODES = np.array([[1.6, 2.0], [2.2, 1.7]])
COVARIANCES = np.array([0.1 * COVARIANCE, 0.05 * np.eye(2)])
SAMPLE = np.array([[1.0, 1.5], [2.0, 1.5], [4.0, 2.5]])
MEMBERS = {
    "uniform": Uniform(SPACE, np.array([1.0, 1.5]), np.array([2.0, 2.5])),
    "point": Uniform.point(SPACE, np.array([1.0, 1.5])),
    "gaussian": Gaussian(SPACE, np.array([1.0, 2.0]), COVARIANCE),
    "prior": Gaussian.prior(SPACE),
    "truncated_gaussian": TruncatedGaussian(SPACE, np.array([1.0, 2.0]), np.array([0.8, 0.1])),
    "beta": Beta(SPACE, np.array([2.0, 0.7]), np.array([3.0, 0.7])),
    "mixture": Mixture(SPACE, WEIGHTS, MODES, 5 * COVARIANCES),
    "empirical": Empirical(SPACE, SAMPLE, np.array([0.5, 0.3, 0.2])),
}
# far from every bound, so that no draw is clipped or cut
INSIDE = {
    "uniform": MEMBERS["uniform"],
    "point": MEMBERS["point"],
    "gaussian": Gaussian(SPACE, np.array([2.0, 1.8]), 0.1 * COVARIANCE),
    "beta": MEMBERS["beta"],
    "mixture": Mixture(SPACE, WEIGHTS, MODES, COVARIANCES),
    "empirical": MEMBERS["empirical"],
}
LINES = {
    "uniform": Uniform(LINE, np.array([1.0]), np.array([2.0])),
    "gaussian": Gaussian(LINE, np.array([2.0]), np.array([[0.5]])),
    "truncated_gaussian": TruncatedGaussian(LINE, np.array([1.0]), np.array([0.8])),
    "beta": Beta(LINE, np.array([2.0]), np.array([3.0])),
    "mixture": Mixture(LINE, WEIGHTS, MODES[:, :1], COVARIANCES[:, :1, :1]),
}
every_member = pytest.mark.parametrize("member", MEMBERS.values(), ids=MEMBERS)
every_line = pytest.mark.parametrize("line", LINES.values(), ids=LINES)


def test_every_kind_is_a_member_of_this_contract():
    assert {member.to_json()["kind"] for member in MEMBERS.values()} == set(KINDS)
    assert set(LINES) == set(KINDS) - {"empirical"}, "which has no density"


@every_member
def test_draws_are_feasible_read_only_and_repeat(member):
    draws = member.sample(500, np.random.default_rng(0)).values
    assert draws.shape == (500, 2)
    assert np.all(draws >= SPACE.feasible_low)
    assert not draws.flags.writeable
    np.testing.assert_array_equal(draws, member.sample(500, np.random.default_rng(0)).values)


@every_member
def test_json_gives_the_same_distribution_back(member):
    copy = distribution_from_json(SPACE, json.loads(json.dumps(member.to_json())))
    np.testing.assert_array_equal(copy.mean, member.mean)
    np.testing.assert_array_equal(copy.std, member.std)
    assert copy.to_json() == member.to_json()
    rng, other = np.random.default_rng(1), np.random.default_rng(1)
    np.testing.assert_array_equal(copy.sample(9, rng).values, member.sample(9, other).values)


@pytest.mark.parametrize("member", INSIDE.values(), ids=INSIDE)
def test_draws_have_the_stated_mean_and_standard_deviation(member):
    n = 40_000
    draws = member.sample(n, np.random.default_rng(2))
    assert draws.adjusted == 0
    np.testing.assert_allclose(
        draws.values.mean(axis=0), member.mean, atol=4 * member.std.max() / np.sqrt(n) + 1e-12
    )
    np.testing.assert_allclose(draws.values.std(axis=0), member.std, rtol=0.02, atol=1e-12)


@every_member
def test_the_density_has_one_value_per_row_and_is_larger_at_draws_than_far_away(member):
    draws = member.sample(50, np.random.default_rng(3)).values
    densities = member.log_prob(draws)
    assert densities.shape == (50,)
    far = member.log_prob(np.array([[0.2, 90.0]]))[0]
    assert far < densities.min()


@every_line
def test_densities_integrate_to_one(line):
    mass, _ = integrate.quad(
        lambda x: np.exp(line.log_prob(np.array([[x]]))[0]), -30, 30, points=[0.1, 1, 2, 2.6]
    )
    assert mass == pytest.approx(1, abs=1e-6)


@every_line
def test_the_share_of_draws_in_an_interval_is_the_integral_of_the_density(line):
    n, low, high = 20_000, 1.3, 1.9
    draws = line.sample(n, np.random.default_rng(4)).values[:, 0]
    share = np.mean((draws > low) & (draws < high))
    expected, _ = integrate.quad(lambda x: np.exp(line.log_prob(np.array([[x]]))[0]), low, high)
    assert share == pytest.approx(expected, abs=4 * np.sqrt(expected / n))


@given(st.floats(0.05, 0.95), st.floats(0.3, 6.0), st.floats(0.05, 2.0))
@settings(deadline=None)
def test_the_density_of_a_quantile_is_the_inverse_of_its_slope(level, mean, std):
    """dq/dp = 1 / density(q), by central differences."""
    truncated = TruncatedGaussian(LINE, np.array([mean]), np.array([std]))
    step = 1e-5
    below, value, above = truncated.quantile(level + step * np.array([[-1.0], [0.0], [1.0]]))
    slope = (above - below)[0] / (2 * step)
    density = np.exp(truncated.log_prob(value[None]))[0]
    assert slope * density == pytest.approx(1, rel=1e-4)

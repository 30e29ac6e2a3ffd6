"""DORAEMON: its formulas, and where its distribution goes."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import approx_fprime

from adr_service.distributions import Beta
from adr_service.methods.doraemon import DoraemonSettings, SuccessRate, divergence, entropy
from tests.planted import PROBLEM, SPACE

THRESHOLD = PROBLEM.task.reward_threshold
SHAPES = np.array([3.0, 1.5, 20.0, 0.8, 2.0, 5.0, 20.0, 1.2])
OTHER = np.array([2.0, 1.5, 30.0, 1.1, 2.5, 4.0, 10.0, 1.0])


def run(succeeds, moves, **settings):
    """The curriculum after moves by returns of 0 or the threshold; `succeeds` sees [0, 1]."""
    rng = np.random.default_rng(0)
    curriculum = DoraemonSettings(**settings).create(PROBLEM)
    kept = [curriculum.distribution]
    for _ in range(moves):
        dynamics = curriculum.sample(128, rng).values
        share = (dynamics - SPACE.low) / (SPACE.high - SPACE.low)
        curriculum.move(dynamics, np.where(succeeds(share), THRESHOLD, 0.0))
        kept.append(curriculum.distribution)
    return kept


def shapes(distribution):
    return np.concatenate([distribution.alpha, distribution.beta])


def test_the_entropy_is_scipys():
    a, b = np.split(SHAPES, 2)
    assert entropy(SHAPES)[0] == pytest.approx(sum(stats.beta.entropy(a, b)))


def test_the_divergence_is_the_mean_log_ratio():
    one, other = (Beta(SPACE, *np.split(each, 2)) for each in (SHAPES, OTHER))
    draws = one.sample(200_000, np.random.default_rng(0)).values
    ratios = one.log_prob(draws) - other.log_prob(draws)
    assert divergence(SHAPES, OTHER)[0] == pytest.approx(
        np.mean(ratios), abs=4 * np.std(ratios) / np.sqrt(len(ratios))
    )
    assert divergence(SHAPES, SHAPES)[0] == pytest.approx(0, abs=1e-12)


def test_the_success_rate_under_other_shapes_is_the_one_of_draws_from_them():
    rng = np.random.default_rng(1)

    def drawn(at):
        return rng.beta(*np.split(at, 2), (200_000, len(SPACE)))

    def succeed(share):
        return share[:, 0] < 0.6

    share, near = drawn(SHAPES), 0.8 * SHAPES + 0.2 * OTHER
    estimate = SuccessRate(share, succeed(share), SHAPES)
    assert estimate(SHAPES)[0] == pytest.approx(np.mean(succeed(share)))
    assert estimate(near)[0] == pytest.approx(np.mean(succeed(drawn(near))), abs=0.01)


@pytest.mark.parametrize("name", ["entropy", "divergence", "success"])
def test_gradients_are_those_of_finite_differences(name):
    share = np.random.default_rng(2).beta(*np.split(SHAPES, 2), (300, len(SPACE)))
    function = {
        "entropy": entropy,
        "divergence": lambda at: divergence(SHAPES, at),
        "success": SuccessRate(share, share[:, 1] > 0.4, SHAPES),
    }[name]
    slope = approx_fprime(OTHER, lambda at: function(at)[0], 1e-6)
    np.testing.assert_allclose(function(OTHER)[1], slope, rtol=1e-3, atol=1e-5)


def test_a_policy_that_always_succeeds_is_given_the_whole_box_in_bounded_moves():
    kept = run(lambda share: np.ones(len(share), bool), moves=24)
    np.testing.assert_allclose(shapes(kept[-1]), 1.0, atol=0.05)
    for before, after in pairwise(kept):
        assert divergence(shapes(before), shapes(after))[0] <= 0.05 + 1e-5
        assert entropy(shapes(after))[0] >= entropy(shapes(before))[0] - 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_a_move_is_made_wherever_more_than_half_succeed(seed):
    """Success is near the centre alone, so that both bounds of a move matter."""
    rng = np.random.default_rng(seed)
    curriculum, moves = DoraemonSettings().create(PROBLEM), 0
    for _ in range(12):
        before = curriculum.distribution
        dynamics = curriculum.sample(64, rng).values
        share = (dynamics - SPACE.low) / (SPACE.high - SPACE.low)
        succeeds = np.linalg.norm(share - 0.5, axis=1) < 0.11
        curriculum.move(dynamics, np.where(succeeds, THRESHOLD, 0.0))
        if np.mean(succeeds) > 0.5:
            moves += 1
            after = shapes(curriculum.distribution)
            assert entropy(after)[0] > entropy(shapes(before))[0] + 1e-3
            assert divergence(shapes(before), after)[0] <= 0.05 + 1e-5
    assert moves >= 5


def test_a_policy_that_never_succeeds_keeps_its_first_distribution():
    kept = run(lambda share: np.zeros(len(share), bool), moves=3)
    np.testing.assert_array_equal(shapes(kept[-1]), shapes(kept[0]))


def test_nothing_moves_before_half_of_the_first_episodes_succeed():
    """A quarter succeeds, and more would elsewhere."""
    kept = run(lambda share: share[:, 0] < 0.48, moves=5)
    np.testing.assert_array_equal(shapes(kept[-1]), shapes(kept[0]))


def test_half_of_the_draws_still_succeed_where_the_box_is_too_hard():
    def succeed(share):
        return np.linalg.norm(share - 0.5, axis=1) < 0.45  # a fifth of the box

    last = run(succeed, moves=40)[-1]
    share = np.random.default_rng(3).beta(last.alpha, last.beta, (20_000, len(SPACE)))
    box = np.random.default_rng(3).random((20_000, len(SPACE)))
    assert np.mean(succeed(box)) < 0.25
    assert 0.4 < np.mean(succeed(share)) < 0.65


def test_the_distribution_moves_back_where_success_is_lost():
    """First all succeed; then those alone whose first parameter is small."""
    rng = np.random.default_rng(4)
    curriculum = DoraemonSettings().create(PROBLEM)
    for move in range(40):
        dynamics = curriculum.sample(128, rng).values
        share = (dynamics - SPACE.low) / (SPACE.high - SPACE.low)
        succeeds = share[:, 0] < 0.35 if move >= 15 else np.ones(128, bool)
        curriculum.move(dynamics, np.where(succeeds, THRESHOLD, 0.0))
    mean = (curriculum.distribution.mean - SPACE.low) / (SPACE.high - SPACE.low)
    assert mean[0] < 0.42
    np.testing.assert_allclose(mean[1:], 0.5, atol=0.1)


@pytest.mark.parametrize(("success", "widens"), [(0.4, True), (0.6, False)])
def test_an_episode_succeeds_from_the_share_of_the_threshold_that_is_set(success, widens):
    curriculum = DoraemonSettings(success=success).create(PROBLEM)
    before = curriculum.distribution.std
    dynamics = curriculum.sample(64, np.random.default_rng(0)).values
    curriculum.move(dynamics, np.full(64, 0.5 * THRESHOLD))
    assert np.all(curriculum.distribution.std > before) == widens


@pytest.mark.parametrize("kl", [0.01, 0.2])
def test_the_first_move_of_a_solved_start_uses_up_the_divergence_that_is_set(kl):
    before, after = run(lambda share: np.ones(len(share), bool), moves=1, kl=kl)
    assert divergence(shapes(before), shapes(after))[0] == pytest.approx(kl, rel=0.01)


def test_a_lower_success_rate_moves_where_the_default_does_not():
    def succeeds(share):
        return share[:, 0] < 0.48

    before, after = run(succeeds, moves=1, success_rate=0.2)
    assert entropy(shapes(after))[0] > entropy(shapes(before))[0] + 0.01
    before, after = run(succeeds, moves=1)
    assert entropy(shapes(after))[0] < entropy(shapes(before))[0] + 0.01

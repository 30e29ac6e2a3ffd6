"""The rule that turns gains by episode into names."""

import numpy as np
import pytest
from scipy.special import expit

from adr_service.criticism.decision import (
    ALIKE,
    THRESHOLD,
    beats,
    decide,
    is_evidence,
    is_unknown,
    least_evident,
)

NOTHING = np.zeros(20)


def decided(gains):
    return decide(np.array(gains), np.random.default_rng(0))


def test_a_gain_below_the_threshold_is_chance():
    gains = np.full(20, 0.9 * THRESHOLD / 20)
    assert not decided([gains]).alike


def test_a_gain_that_hangs_on_one_episode_is_chance():
    gains = NOTHING.copy()
    gains[3] = 10 * THRESHOLD
    assert not decided([gains]).alike


def test_the_best_that_is_more_than_chance_is_named_beside_a_larger_one_that_is_not():
    flaky = np.full(20, -0.5)
    flaky[:2] = 60.0
    decision = decided([flaky, np.full(20, 4.0)])
    assert decision.alike == (1,)
    assert decision.confidence[1] > 0.99


def test_what_few_episodes_show_clearly_is_evidence():
    gains = NOTHING.copy()
    gains[:3] = 100.0
    assert decided([gains]).alike == (0,)


def test_without_candidates_nothing_is_named():
    assert not decided(np.empty((0, 20))).alike


def test_the_better_of_two_is_named_with_all_confidence():
    decision = decided([np.full(20, 2.0), np.full(20, 5.0)])
    assert decision.alike == (1,)
    assert decision.confidence[1] > 0.99


def test_two_that_differ_by_less_than_their_difference_varies_are_tied():
    noise = np.random.default_rng(1).normal(0, 3, 20)
    decision = decided([5 + noise, np.full(20, 5.2)])
    assert set(decision.alike) == {0, 1}


def test_what_a_flexible_force_explains_beside_a_cause_decides_whether_that_is_it():
    flexible = np.full(20, 9.0)
    assert is_unknown(flexible, named=100.0)
    assert not is_unknown(flexible, named=2000.0)
    assert not is_unknown(np.full(20, 1.0), named=0.0)  # chance


def test_probabilities_of_all_candidates_and_of_none_add_up_to_one():
    decision = decided([np.full(20, 2.0), np.full(20, 2.1), NOTHING])
    assert decision.confidence.sum() == pytest.approx(1.0)
    assert decision.confidence[2] == 0.0  # no evidence


def test_a_difference_within_the_error_of_a_large_gain_decides_nothing():
    difference = np.full(20, 1.0)
    assert beats(difference, gain=100.0)
    assert not beats(difference, gain=20.0 / ALIKE)


def test_evidence_begins_at_25_nats():
    assert not is_evidence(np.full(20, 24.0 / 20))
    assert is_evidence(np.full(20, 26.0 / 20))


def test_gains_of_two_episodes_count_from_two_standard_errors_of_their_sum():
    gains = NOTHING.copy()
    gains[:2] = 30.0  # 60 nats, with a standard error of 41.3
    assert not is_evidence(gains)
    assert is_evidence(gains + 2.0)


def test_a_difference_counts_from_two_standard_errors_or_four_nats():
    spread = np.tile([1.0, -1.0], 10)
    spread /= spread.std(ddof=1)
    border = 2 * np.sqrt(20)
    assert not beats(spread + 0.9 * border / 20, gain=0.0)
    assert beats(spread + 1.1 * border / 20, gain=0.0)
    assert not beats(np.full(20, 3.5 / 20), gain=0.0)
    assert beats(np.full(20, 4.5 / 20), gain=0.0)


def test_the_cause_is_unknown_where_a_flexible_force_adds_more_than_a_fifth():
    flexible = np.full(20, 5.0)  # 100 nats
    assert is_unknown(flexible, named=490.0)
    assert not is_unknown(flexible, named=510.0)


@pytest.mark.parametrize(
    "information",
    [
        np.full(20, 3.0),
        np.array([100.0, 80.0, *np.full(18, 0.1)]),  # two are much, but the rest suffices
    ],
)
def test_the_least_evident_strength_is_just_evidence(information):
    least = least_evident(information)
    assert is_evidence(0.5 * (1.01 * least) ** 2 * information)
    assert not is_evidence(0.5 * (0.99 * least) ** 2 * information)


def test_no_strength_is_evidence_where_only_two_episodes_would_show_it():
    assert np.isinf(least_evident(np.array([50.0, 40.0, *np.zeros(18)])))


def test_confidence_is_against_the_gain_of_chance_and_unsure_where_episodes_disagree():
    just = decided([np.full(20, (THRESHOLD + 1) / 20)]).confidence
    np.testing.assert_allclose(just, [expit(1), expit(-1)], rtol=1e-6)
    apart = np.tile([9.0, -9.0], 10)  # 6 nats of difference, with an error of 80
    assert 0.3 < decided([5 + apart, 5.3 - apart]).confidence[1] < 0.7

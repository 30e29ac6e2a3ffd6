"""Summaries of trajectories, and of replays under other dynamics."""

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.simulation.summaries import Scale, SummarisedReplays, outside, summary
from tests.planted import ARM, PLANTED, SOURCE, SPACE, recorded, waving_policy

DATA = recorded(waving_policy(), episodes=2, steps=30)


def replays(length, n=4):
    return SummarisedReplays(ARM, SOURCE, DATA, n, length)


def test_a_summary_has_products_means_and_variances_of_changes():
    changes = np.array([[[1.0, 0.0], [3.0, 2.0]]])  # (1, 2, 2)
    actions = np.array([[1.0], [2.0]])
    expected = [(1 * 1 + 3 * 2) / 2, (0 * 1 + 2 * 2) / 2, 2.0, 1.0, 1.0, 1.0]
    np.testing.assert_allclose(summary(changes, actions)[0], expected)


@pytest.mark.parametrize("length", [1, 7, None])
def test_under_the_true_dynamics_a_replay_has_the_recordings_summary(length):
    """All columns of the arm are measured without noise here, so the replay is the recording."""
    replay = replays(length)
    simulated = replay.simulate(np.stack([PLANTED, 0.9 * PLANTED]))
    np.testing.assert_allclose(simulated[0], replay.recorded, rtol=1e-9, atol=1e-12)
    assert not np.allclose(simulated[1], replay.recorded, rtol=1e-3)


def test_whole_episodes_drift_further_from_the_recording_than_segments():
    distances = []
    for length in (1, 10, None):
        replay = replays(length)
        wrong = replay.simulate(1.1 * PLANTED[None])[0]
        distances.append(np.linalg.norm(wrong - replay.recorded))
    assert distances == sorted(distances)


def test_batches_change_no_bit():
    dynamics = np.random.default_rng(0).uniform(SPACE.low, SPACE.high, (7, len(SPACE)))
    one, other = (replays(5, n).simulate(dynamics) for n in (2, 7))
    np.testing.assert_array_equal(one, other)


def test_replays_that_diverge_are_left_out_and_too_few_others_are_refused(monkeypatch):
    replay = replays(None)
    broken = np.arange(40) % 4 == 0
    made = np.where(broken[:, None], np.nan, np.arange(40.0)[:, None])
    monkeypatch.setattr(replay, "simulate", lambda dynamics, _: made[: len(dynamics)])
    held, simulated = replay.usable(np.zeros((40, 4)))
    np.testing.assert_array_equal(held, ~broken)
    assert len(simulated) == 30
    with pytest.raises(InvalidInput, match=r"6 of 24 replays diverged.*shorter `segment`"):
        replay.usable(np.zeros((24, 4)))


def test_features_keep_their_order_without_long_tails_and_constant_ones_are_dropped():
    simulated = np.random.default_rng(0).normal([5.0, 7.0, -2.0], [2.0, 0.0, 0.1], (501, 3))
    simulated[0, 0] = 1e9
    scale = Scale.of(simulated)
    features = scale(simulated)
    assert features.shape == (501, 2)
    np.testing.assert_allclose(np.median(features, axis=0), 0.0, atol=1e-12)
    np.testing.assert_array_equal(np.argsort(features[:, 0]), np.argsort(simulated[:, 0]))
    assert 0.3 < features[1:, 0].std() < 1
    assert features.max() < 25
    assert scale(simulated[0]).shape == (2,)


def test_statistics_with_one_value_in_the_middle_half_are_dropped_though_others_differ():
    simulated = np.stack([np.arange(100.0), np.zeros(100)], axis=1)
    simulated[:20, 1] = 1.0
    assert Scale.of(simulated)(simulated).shape == (100, 1)


def test_replays_that_depend_on_no_parameter_are_refused():
    with pytest.raises(InvalidInput, match=r"no statistic of the replays depends .* in 40 replays"):
        Scale.of(np.tile(np.arange(12.0), (40, 1)))


def test_statistics_beyond_all_simulations_are_counted():
    simulated = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    assert outside(simulated, np.array([0.5, 1.5, -0.1])) == 2

"""The worth of an effect on episodes that nothing was fitted to."""

import json
from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.gain import measure_gain, share_removed, share_within
from adr_service.criticism.measurements import Measurement
from tests.hidden import recorded


def gained(before, after, sealed):
    return measure_gain(before, after, sealed, threads=1)


@pytest.fixture(scope="module")
def sealed(hidden):
    return hidden.episodes(range(12, 20))


@pytest.fixture(scope="module")
def gain(baseline, refined, sealed):
    """The gain of the effect that the data have."""
    return gained(baseline, refined, sealed)


def test_a_fit_gains_nothing_over_itself(baseline, hidden):
    gain = gained(baseline, baseline, hidden.episodes(range(12, 16)))
    assert (gain.sse_removed, gain.low, gain.high) == (0.0, 0.0, 0.0)
    assert all(before == after for before, after in gain.horizons.values())
    np.testing.assert_array_equal(gain.trace.without, gain.trace.extended)


def test_the_true_effect_gains_on_sealed_episodes(gain):
    assert gain.low > 0
    assert gain.explainable_fraction > 0.5
    assert gain.diverged == (0, 0)
    assert set(gain.horizons) == {1, 5, 25}
    without, extended = gain.horizons[25]  # one step is mostly noise
    assert extended < without


def test_the_share_that_is_removed_is_that_of_the_gain(baseline, refined, sealed, gain):
    removed = share_removed(baseline, refined, sealed, threads=1)
    assert removed == (gain.sse_removed, gain.low, gain.high)


def test_of_what_is_noise_alone_no_share_is_explained(refined, sealed):
    """The fit before has the effect already, and leaves noise alone."""
    gain = gained(refined, refined, sealed)
    assert (gain.explainable_fraction, gain.explainable_interval) == (None, None)


def test_the_loss_of_the_true_effect_is_no_gain(baseline, refined, sealed):
    assert gained(refined, baseline, sealed).high < 0


def test_the_interval_contains_the_value(gain):
    assert gain.low < gain.sse_removed < gain.high <= 1
    low, high = gain.explainable_interval
    assert low < gain.explainable_fraction <= high <= 1


def test_the_trace_starts_where_the_robot_was(gain):
    trace = gain.trace
    assert trace.time[0] == 0
    assert trace.measured.shape == trace.without.shape == trace.extended.shape
    for simulated in (trace.without, trace.extended):
        np.testing.assert_array_equal(simulated[0], trace.measured[0])
    errors = [np.abs(each - trace.measured).mean() for each in (trace.without, trace.extended)]
    assert errors[1] < errors[0]


def test_what_is_not_measured_has_no_errors(baseline, refined, sealed):
    """The unit is the extended simulator's error of one step, in what is measured alone."""
    blind = replace(sealed, qvel_std=np.full(2, np.inf))
    without, extended = gained(baseline, refined, blind).horizons[1]
    assert extended == pytest.approx(1.0)
    assert without > 1.0


def test_short_episodes_have_no_far_horizon(baseline, refined, sealed):
    arrays = recorded(sealed)
    rows = np.concatenate([np.arange(first, first + 7) for first, _ in sealed.spans()])
    short = Measurement(**{name: values[rows] for name, values in arrays.items()})
    assert set(gained(baseline, refined, short).horizons) == {1, 5}


def test_a_gain_has_no_nan_in_json(gain):
    assert json.dumps(gain.to_json(), allow_nan=False)


@pytest.mark.parametrize("episodes", [2, 3, 8])
def test_a_share_is_within_its_interval_as_often_as_it_says(episodes):
    """A bootstrap over two episodes covers half of the truths."""
    rng = np.random.default_rng(0)
    whole = rng.uniform(80, 120, (4000, episodes))
    part = 0.6 * whole + rng.normal(0, 10, whole.shape)
    shares = [share_within(*each) for each in zip(part, whole, strict=True)]
    covered = np.mean([low <= 0.6 <= high for _, low, high in shares])
    assert covered == pytest.approx(0.95, abs=0.02)


def test_no_more_than_all_is_removed_at_the_end_of_an_interval():
    share, low, high = share_within(np.array([90.0, 70.0]), np.array([100.0, 100.0]))
    assert (share, high) == (0.8, 1.0)
    assert low < 0


def test_two_episodes_that_lose_a_little_refute_nothing():
    """Each sign is as likely as the other where there is no gain at all."""
    assert share_within(np.array([-3.0, -1.0]), np.array([100.0, 100.0]))[2] > 0
    assert share_within(np.array([-3.1, -3.0]), np.array([100.0, 100.0]))[2] < 0


def test_an_overestimated_noise_changes_no_explained_share(baseline, refined, sealed):
    """With sensors taken to be twice as noisy, what is left is noise, and all else is explained."""
    noise = replace(refined.noise, sensor=4 * refined.noise.sensor)
    gain = gained(baseline, replace(refined, noise=noise), sealed)
    assert gain.explainable_fraction == pytest.approx(1.0)

"""States that are the most probable under a fit, episode by episode."""

from dataclasses import replace

import numpy as np

from adr_service.criticism import probable_states
from adr_service.criticism.fits import likelier_of, noise_anew
from adr_service.criticism.probable_states import linearised, smoothed


def test_each_episode_has_the_states_that_make_it_likelier(baseline):
    """Here every second episode of the other fit was spoilt."""
    share = np.arange(len(baseline.held_out)) % 2 * 1.0
    spoilt = replace(baseline, states=baseline.states + 0.1)
    other = linearised(spoilt, share)
    chosen, is_likelier = likelier_of(baseline, other)
    assert is_likelier.tolist() == (other.held_out > baseline.held_out).tolist()
    assert not is_likelier[share == 0].any()
    episodes = baseline.simulator.data.episode
    numbers = np.unique(episodes, return_inverse=True)[1]
    expected = np.where(is_likelier[numbers][:, None], other.states, baseline.states)
    np.testing.assert_array_equal(chosen.states, expected)
    starts = baseline.simulator.starts
    predicted = np.where(is_likelier[numbers][starts][:, None], other.predicted, baseline.predicted)
    np.testing.assert_array_equal(chosen.predicted, predicted)
    assert chosen.held_out.sum() > other.held_out.sum()


def test_states_are_part_of_the_way_to_the_most_probable_ones(baseline):
    whole, half, none = (
        linearised(baseline, np.full(len(baseline.held_out), share)) for share in (1.0, 0.5, 0.0)
    )
    np.testing.assert_array_equal(none.states, baseline.states)
    np.testing.assert_allclose(half.states, (whole.states + baseline.states) / 2, atol=1e-12)


def test_states_that_make_every_episode_less_likely_are_approached_by_half(baseline, monkeypatch):
    shares = []

    def spoiling(fit, share):
        shares.append(share[0])
        if len(shares) == 1:  # parameters settle about these
            return linearised(fit, share)
        return linearised(replace(fit, states=fit.states + 0.1), np.zeros(len(share)))

    monkeypatch.setattr(probable_states, "linearised", spoiling)
    found = smoothed(baseline)
    assert shares == [1.0, 1.0, 0.5]
    np.testing.assert_array_equal(found.states, linearised(baseline, np.ones(8)).settled.states)


def test_a_parameter_at_its_bound_stays_there_as_states_are_chosen(baseline):
    """Misfit that only a parameter beyond its bound would explain is evidence."""
    space, linear = baseline.simulator.nominal.space, baseline.linear
    beyond = 0.1 * (space.high - space.low)
    misfit = linear.columns[..., : len(beyond)] @ beyond
    asked = replace(
        baseline,
        parameters=space.high,
        linear=replace(linear, residual=linear.residual + misfit),
    )
    kept = noise_anew(asked)
    assert np.all(kept.normal.change()[0][: len(beyond)] < 0.01 * beyond)

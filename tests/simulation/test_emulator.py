"""Polynomials in place of a replay, and the error that they report."""

import numpy as np
import pytest

from adr_service.randomness import stream
from adr_service.simulation.emulator import Emulator, draws_to_fit
from adr_service.simulation.replay import Replay
from tests.planted import ARM, PLANTED, SOURCE, recorded, waving_policy

REPLAY = Replay(ARM, SOURCE, recorded(waving_policy(), steps=40), 8, 1)


class BrokenReplay:
    """The replay, but its fourth window diverges under a heavy upper arm."""

    targets = REPLAY.targets

    def predict(self, dynamics):
        predictions = REPLAY.predict(dynamics)
        predictions[dynamics[:, 0] > PLANTED[0], 3] = np.nan
        return predictions


def fitted(share, replay=REPLAY):
    """An emulator for a box around the planted dynamics."""
    low, high = PLANTED / (1 + share), PLANTED * (1 + share)
    return Emulator.fit(replay, low, high, stream("emulator"))


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_the_reported_error_is_that_of_fresh_simulations(share):
    emulator = fitted(share)
    draws = PLANTED * stream("fresh").uniform(1 / (1 + share), 1 + share, (50, 4))
    errors = emulator.predict(draws) - REPLAY.predict(draws)
    measured, reported = np.sqrt(np.mean(errors**2)), np.sqrt(np.mean(emulator.error**2))
    assert 0.2 < measured / reported < 5


def test_a_smaller_box_is_emulated_better():
    """A cubic's error falls with the fourth power of the width: by 1e-4 here."""
    wide, narrow = (np.sqrt(np.mean(fitted(share).error ** 2)) for share in (0.5, 0.05))
    assert narrow < 1e-3 * wide


def test_a_window_that_diverges_is_uncertain_and_the_others_are_as_before():
    whole, broken = fitted(0.5), fitted(0.5, BrokenReplay())
    assert whole.diverged == 0
    assert 0 < broken.diverged < broken.simulated
    assert np.all(np.isfinite(broken.error))
    others = np.arange(len(REPLAY.targets)) != 3
    np.testing.assert_allclose(broken.error[others], whole.error[others])
    assert broken.error[3].max() > 10 * whole.error[3].max()


def test_the_share_of_the_box_is_above_one_outside_alone():
    emulator = fitted(0.5)
    assert np.all(emulator.share(PLANTED[None]) == 0)
    inside = PLANTED * np.array([[0.9], [1.1]])
    assert np.all(emulator.share(inside) < 1)
    outside = PLANTED * np.array([1.0, 1.6, 1.0, 1.0])
    assert (emulator.share(outside[None]) > 1).tolist() == [False, True, False, False]


def test_a_fit_simulates_as_many_draws_as_planned():
    assert fitted(0.5).simulated == draws_to_fit(4)


def test_the_draws_of_a_fit_grow_with_the_parameters_up_to_cubics():
    """Beyond eight parameters the polynomials are quadratic, and need fewer draws."""
    needed = [draws_to_fit(d) for d in (1, 4, 8, 9)]
    assert needed[0] < needed[1] < needed[2] > needed[3]

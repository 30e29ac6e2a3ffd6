"""The polynomial in place of replay: its error is what fresh simulations show."""

import numpy as np
import pytest

from adr_service.randomness import stream
from adr_service.simulation.emulator import Emulator, draws_to_fit
from adr_service.simulation.replay import Replay
from adr_service.tasks.catalogue import get_task, source_of
from tests.recordings import recording

PLANTED = np.array([1.6, 1.2, 3.0, 2.0])
REPLAY = Replay(get_task("arm"), source_of("arm", "vanilla"), recording("arm", 40, PLANTED), 8, 1)


def fitted(share, replay=REPLAY):
    """An emulator in the box from PLANTED / (1 + share) to PLANTED (1 + share)."""
    low, high = PLANTED / (1 + share), PLANTED * (1 + share)
    return Emulator.fit(replay, low, high, stream("emulator"))


def rms(values):
    return np.sqrt(np.mean(values**2))


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_its_stated_error_is_that_of_fresh_simulations(share):
    emulator = fitted(share)
    draws = PLANTED * stream("fresh").uniform(1 / (1 + share), 1 + share, (50, 4))
    errors = emulator.predict(draws) - REPLAY.predict(draws)
    assert 0.2 < rms(errors) / rms(emulator.error) < 5


def test_a_smaller_box_is_emulated_better():
    wide, narrow = (rms(fitted(share).error) for share in (0.5, 0.05))
    assert narrow < 1e-3 * wide  # a cubic's error falls with the fourth power: 1e-4


def test_a_window_that_diverges_is_uncertain_and_the_others_are_as_before():
    class Broken:
        """The replay, but window 3 diverges where the first parameter is large."""

        targets = REPLAY.targets

        def predict(self, dynamics):
            predictions = REPLAY.predict(dynamics)
            predictions[dynamics[:, 0] > PLANTED[0], 3] = np.nan
            return predictions

    whole, broken = fitted(0.5), fitted(0.5, Broken())
    assert whole.diverged == 0
    assert 0 < broken.diverged < broken.simulated
    assert np.all(np.isfinite(broken.error))
    others = np.arange(len(REPLAY.targets)) != 3
    np.testing.assert_allclose(broken.error[others], whole.error[others])
    assert broken.error[3].max() > 10 * whole.error[3].max()


def test_draws_at_a_point_fill_nothing_of_the_box_and_those_outside_more_than_all():
    emulator = fitted(0.5)
    assert np.all(emulator.share(PLANTED[None]) == 0)
    inside = PLANTED * np.array([[0.9], [1.1]])
    assert np.all(emulator.share(inside) < 1)
    outside = PLANTED * np.array([1.0, 1.6, 1.0, 1.0])
    assert (emulator.share(outside[None]) > 1).tolist() == [False, True, False, False]


@pytest.mark.parametrize("d", [1, 4, 13, 30])
def test_a_fit_replays_two_draws_per_coefficient_and_sixteen_checks(d):
    """Cubic up to 200 coefficients, (d + 3 choose 3); else quadratic, (d + 2 choose 2)."""
    cubic, quadratic = (d + 3) * (d + 2) * (d + 1) // 6, (d + 2) * (d + 1) // 2
    coefficients = cubic if cubic <= 200 else quadratic
    assert draws_to_fit(d) == 2 * coefficients + 16


def test_a_fit_simulates_as_many_draws_as_it_announces():
    assert fitted(0.1).simulated == draws_to_fit(4)

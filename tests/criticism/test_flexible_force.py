"""A flexible force, beside fits that lack something and fits that lack nothing."""

import numpy as np
import pytest

from adr_service.criticism.decision import is_evidence
from adr_service.criticism.evidence import fit, settled, smoothed
from adr_service.criticism.flexible_force import flexible_gains
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Simulator
from benchmarks.planted import draw_case
from tests.hidden import arm


def gains(nominal, data):
    """Gains beside a fit without any effect."""
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        return flexible_gains(smoothed(fit(simulator, sensor), sensor), sensor)


def test_a_flexible_force_gains_nothing_where_nothing_is_hidden(clean):
    assert not is_evidence(gains(arm()[1], Measurement(**clean)))


@pytest.mark.parametrize(
    ("seed", "ratio", "effect"), [(300, 1.0, "gain_drift"), (312, 0.3, "disturbance")]
)
def test_a_flexible_force_gains_where_an_effect_outside_the_catalogue_is(seed, ratio, effect):
    case = draw_case(*arm(), np.random.default_rng(seed), ratio, outside=True)
    assert case.outside == effect
    assert is_evidence(gains(case.nominal, case.measurement.episodes(range(12))))


def test_a_flexible_force_adds_nothing_to_the_true_effect(refined, sensor):
    assert not is_evidence(flexible_gains(settled(refined, sensor), sensor))


def test_every_episode_has_its_own_gain(baseline, sensor):
    gained = flexible_gains(baseline, sensor)
    assert gained.shape == (12,)
    assert np.all(np.isfinite(gained))

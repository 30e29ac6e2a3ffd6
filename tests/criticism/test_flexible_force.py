"""A flexible force, beside fits that lack something and fits that lack nothing."""

import numpy as np
import pytest

from adr_service.criticism.decision import is_evidence
from adr_service.criticism.evidence import fit, refine, settled, smoothed
from adr_service.criticism.flexible_force import unexplained
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from benchmarks.outside import Force
from benchmarks.planted import draw_case, hide
from tests.hidden import arm


def found(nominal, data, *effects):
    """What a flexible force explains beside a fit with these effects."""
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, sensor), sensor)
        return unexplained(refine(baseline, effects, sensor), sensor)


def test_a_flexible_force_gains_nothing_where_nothing_is_hidden(clean):
    assert not is_evidence(found(arm()[1], Measurement(**clean)).gains)


@pytest.mark.parametrize(
    ("seed", "ratio", "effect", "depends_on"),
    [(300, 1.0, "gain_drift", "time"), (312, 0.3, "disturbance", "time, swinging at 2.7 Hz")],
)
def test_a_flexible_force_gains_where_an_effect_outside_the_catalogue_is(
    seed, ratio, effect, depends_on
):
    case = draw_case(*arm(), np.random.default_rng(seed), ratio, outside=True)
    assert case.outside == effect
    rest = found(case.nominal, case.measurement.episodes(range(12)))
    assert is_evidence(rest.gains)
    assert rest.depends_on == depends_on


FRICTION = Effect("joint_coulomb_friction", "joint:elbow", (0.01,))
GAIN = Effect("actuator_gain", "actuator:elbow", (-0.02,))
FADE = Effect("actuator_fade", "actuator:elbow", (0.07,))


@pytest.mark.parametrize(
    ("kind", "size", "mean", "depends_on"),
    [
        ("torque_ripple", 0.1, (), "its position"),
        ("position_dependent_friction", 0.1, (FRICTION,), "its position"),
        ("cross_coupling", 0.3, (), "its motion and the commands"),
    ],
)
def test_what_varies_about_a_named_mean_is_found_with_its_joint(kind, size, mean, depends_on):
    force = Force(kind, dof=1, actuator=1, other=0, size=size)  # of a motor of 12 N m
    data = hide(*arm(), np.random.default_rng(5), [], force).episodes(range(12))
    rest = found(arm()[1], data, *mean)
    assert rest.gains.sum() > 100
    assert (rest.location, rest.depends_on) == ("joint:elbow", depends_on)


def test_a_gain_that_fades_within_every_episode_is_more_than_its_mean():
    data = hide(*arm(), np.random.default_rng(5), [FADE]).episodes(range(12))
    rest = found(arm()[1], data, GAIN)
    assert rest.gains.sum() > 300
    assert (rest.location, rest.depends_on) == ("joint:elbow", "time")


def test_a_flexible_force_adds_nothing_to_the_true_effect(refined, sensor):
    assert not is_evidence(unexplained(settled(refined, sensor), sensor).gains)


def test_every_episode_has_its_own_gain(baseline, sensor):
    gained = unexplained(baseline, sensor).gains
    assert gained.shape == (12,)
    assert np.all(np.isfinite(gained))

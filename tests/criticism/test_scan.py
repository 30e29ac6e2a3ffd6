"""The scan over all effects at all places."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.evidence import fit, smoothed
from adr_service.criticism.linear import Normal
from adr_service.criticism.noise import Whitener
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import location_of, places, scan
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from tests.hidden import arm


def test_one_effect_at_all_places_is_a_group():
    """With a strength for each, where it explains more than any single place."""
    hidden = [
        Effect("joint_coulomb_friction", "joint:shoulder", (0.2,)),
        Effect("joint_coulomb_friction", "joint:elbow", (0.1,)),
    ]
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(401), hidden).episodes(range(12))
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, sensor))
        best, *others = scan(baseline, Responses(baseline))
    assert (best.kind, best.location) == ("joint_coulomb_friction", "joint:*")
    assert best.gain > max(c.gain for c in others if len(c.effects) == 1) + THRESHOLD
    strengths = {cause.location: cause.values[0] for cause in best.effects}
    expected = {cause.location: cause.values[0] for cause in hidden}
    assert strengths == pytest.approx(expected, rel=0.3)  # to first order


def test_two_strengths_of_one_effect_do_not_hide_each_other():
    """This friction is gone at .7 rad/s, and nearly always the joint is faster."""
    hidden = Effect("joint_stribeck_friction", "joint:shoulder", (0.7, 1.0))
    (task, nominal), rng = arm(), np.random.default_rng(405)
    fast = np.repeat(rng.choice([-1.0, 1.0], (30, 19, 2)), 4, axis=1)
    data = hide(task, nominal, rng, [hidden], commands=fast)
    sensor = data.sensor_variance()
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, sensor))
        candidates = scan(baseline, Responses(baseline))
    found = next(c for c in candidates if (c.kind, c.location) == (hidden.kind, hidden.location))
    assert np.isfinite(found.deviations).all()
    assert found.gain > max(c.gain for c in candidates if c.location != hidden.location)


def test_a_group_is_named_after_the_kind_of_its_places():
    springs = [Effect("joint_spring", f"joint:{name}", (1.0,)) for name in ("shoulder", "elbow")]
    assert location_of(springs) == "joint:*"
    assert location_of(springs[:1]) == "joint:shoulder"


def test_sensors_without_readings_are_no_places():
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(401), []).episodes(range(2))
    unread = type(data)(data.time, data.qpos, data.qvel, data.ctrl, data.episode, [np.inf, 0.1])
    with (
        Simulator(nominal, data, threads=1) as all_read,
        Simulator(nominal, unread, threads=1) as one,
    ):
        missing = set(places(all_read)) - set(places(one))
    places_of_it = {("joint_backlash", "joint:shoulder")}
    assert {e for e in missing if e[1] != "sensor:shoulder.position"} == places_of_it


def test_responses_of_an_earlier_fit_count_where_the_later_one_simulates(baseline):
    mask = baseline.linear.chain.mask.copy()
    mask[3, 40:] = False
    there = mask[..., None]
    linear = replace(
        baseline.linear,
        chain=baseline.linear.chain.where(mask),
        residual=np.where(there, baseline.linear.residual, 0.0),
        columns=np.where(there[..., None], baseline.linear.columns, 0.0),
    )
    normal = Normal.of(Whitener.of(linear.chain, baseline.noise), linear)
    later = replace(baseline, linear=linear, normal=normal)
    one, other = (scan(later, Responses(fitted)) for fitted in (baseline, later))
    assert [c.location for c in one[:20]] == [c.location for c in other[:20]]
    np.testing.assert_allclose([c.gain for c in one], [c.gain for c in other], rtol=1e-6)

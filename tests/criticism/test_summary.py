"""Numbers of a verdict: intervals of strengths, what is left, and detection limits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from adr_service.criticism.fits import refine
from adr_service.criticism.flexible_force import Unexplained
from adr_service.criticism.naming import Weighed
from adr_service.criticism.scan import Candidate
from adr_service.criticism.summary import alternative, named_cause, residual_of
from adr_service.criticism.verdict import Rest
from adr_service.effects.base import Effect

ELSEWHERE = Effect("joint_coulomb_friction", "joint:shoulder", (0.01,))


def weighed(fit, *effects):
    return Weighed(effects, fit, np.full(12, 5.0), 0.75)


@pytest.fixture(scope="module")
def group(baseline, friction):
    """A fit with friction at both joints."""
    return refine(baseline, [ELSEWHERE, friction])


def test_an_interval_contains_the_planted_strength(refined, friction):
    cause = named_cause(refined, slice(0, 1), weighed(refined, friction))
    (strength,) = cause.strengths
    assert (cause.kind, cause.location) == (friction.kind, friction.location)
    assert strength.low < friction.values[0] < strength.high
    assert strength.low < strength.value == refined.effects[0].values[0] < strength.high
    assert strength.unit == "N m"


def test_an_interval_is_as_wide_as_its_level_asks_for(refined, friction):
    """Student's 97.5 % quantile of its deviation on either side: 2.57 with few episodes."""
    (strength,) = named_cause(refined, slice(0, 1), weighed(refined, friction)).strengths
    (variance,) = np.diagonal(refined.normal.covariance())[refined.columns_of(slice(0, 1))]
    deviation = np.sqrt(variance)
    assert 1.96 < (strength.high - strength.value) / deviation < 3
    assert strength.high - strength.value == pytest.approx(strength.value - strength.low)


def test_a_cause_has_the_gain_and_the_confidence_of_its_evidence(refined, friction):
    cause = named_cause(refined, slice(0, 1), weighed(refined, friction))
    assert (cause.gain, cause.confidence) == (60.0, 0.75)


def test_strengths_of_a_group_are_named_after_their_places(group):
    cause = named_cause(group, slice(0, 2), weighed(group, *group.effects))
    assert cause.location == "joint:*"
    names = [each.name for each in cause.strengths]
    assert [name.split()[0] for name in names] == ["shoulder", "elbow"]
    assert [each.value for each in cause.strengths] == [e.values[0] for e in group.effects]


def test_each_cause_of_a_fit_has_its_own_columns(group):
    """The two joints have intervals of their own, alone as in the group."""
    whole = named_cause(group, slice(0, 2), weighed(group, *group.effects)).strengths
    for number, effect in enumerate(group.effects):
        slot = slice(number, number + 1)
        (alone,) = named_cause(group, slot, weighed(group, effect)).strengths
        assert (alone.low, alone.high) == (whole[number].low, whole[number].high)


def test_an_alternative_has_the_strength_of_its_own_fit(group):
    other = weighed(group, replace(group.effects[1], values=(9.0,)))
    cause = alternative(other)
    assert cause.location == group.effects[1].location
    assert cause.strengths[0].value == group.effects[1].values[0]


def test_an_interval_stays_where_the_strength_makes_sense(refined, friction):
    """Friction is never negative."""
    none = replace(refined, effects=(replace(friction, values=(1e-9,)),))
    (strength,) = named_cause(none, slice(0, 1), weighed(none, friction)).strengths
    assert strength.low == 0.0
    assert strength.high > 1e-9


def test_a_strength_that_the_data_do_not_determine_has_no_bounds(refined, friction):
    information, score = refined.normal.information.copy(), refined.normal.score.copy()
    information[:, -1], information[:, :, -1], score[:, -1] = 0.0, 0.0, 0.0
    blind = replace(refined, normal=replace(refined.normal, information=information, score=score))
    (strength,) = named_cause(blind, slice(0, 1), weighed(blind, friction)).strengths
    assert (strength.low, strength.high) == (-np.inf, np.inf)


def left(nats):
    """A flexible force that gains this much on each of twelve episodes."""
    return Unexplained(np.full(12, nats), Rest("joint:elbow", "time", None))


def candidate(*effects, limit):
    return Candidate(effects, effects, np.zeros(12), np.full(len(effects), limit))


def test_detection_limits_are_those_of_single_effects_that_can_be_seen(baseline, friction):
    first = [
        candidate(friction, limit=0.002),
        candidate(ELSEWHERE, limit=np.inf),  # the data do not determine it
        candidate(ELSEWHERE, friction, limit=0.1),  # a group
    ]
    limits = residual_of(baseline, baseline, first, (), left(0.0)).detectable
    assert limits == {"joint_coulomb_friction joint:elbow": (0.002, "N m")}


def test_a_detection_limit_is_that_of_the_first_strength_that_could_be_evidence(baseline):
    tilt = Effect("gravity_tilt", "global", (0.1, 0.1))
    rolls = Candidate((tilt,), (tilt,), np.zeros(12), np.array([np.inf, 0.002]))
    limits = residual_of(baseline, baseline, [rolls], (), left(0.0)).detectable
    assert limits == {"gravity_tilt global roll": (0.002, "rad")}


@pytest.mark.parametrize(("nats", "rest"), [(0.0, "none"), (1.0, "none"), (10.0, "unknown")])
def test_the_rest_is_unknown_where_a_flexible_force_has_evidence(baseline, nats, rest):
    residual = residual_of(baseline, baseline, [], (), left(nats))
    assert residual.unexplained_nats == 12 * nats
    assert residual.rest == rest
    where = {"location": "joint:elbow", "depends_on": "time", "hertz": None}
    assert residual.to_json()["where"] == (None if rest == "none" else where)


def test_parameters_at_their_bounds_are_listed(baseline):
    space = baseline.simulator.nominal.space
    bounded = baseline.parameters.copy()
    bounded[0], bounded[2] = space.high[0], space.feasible_low[2]
    moved = residual_of(baseline, replace(baseline, parameters=bounded), [], (), left(0.0))
    assert moved.at_bound == (space.names[0], space.names[2])
    assert tuple(moved.moved) == space.names
    fitted = (baseline.parameters[0], space.high[0])
    assert moved.moved[space.names[0]] == pytest.approx(fitted)


def test_steps_and_noise_are_those_of_the_final_fit(baseline, refined):
    residual = residual_of(baseline, refined, [], (), left(0.0))
    assert residual.own_step == pytest.approx(3 * residual.step)
    np.testing.assert_allclose(residual.noise, [1e-3, 1e-3, 1e-2, 1e-2], rtol=0.2)


def test_every_transition_is_counted_once(baseline):
    residual = residual_of(baseline, baseline, [], (), left(0.0))
    assert (residual.used, residual.diverged) == (8 * 75, 0)
    mask = baseline.linear.chain.mask.copy()
    mask[0, :3] = False
    chain = baseline.linear.chain.where(mask)
    fewer = replace(baseline, linear=replace(baseline.linear, chain=chain))
    residual = residual_of(baseline, fewer, [], (), left(0.0))
    assert (residual.used, residual.diverged) == (8 * 75 - 3, 3)


def test_an_interval_has_at_least_half_the_episodes_as_degrees_of_freedom(refined, friction):
    (strength,) = named_cause(refined, slice(0, 1), weighed(refined, friction)).strengths
    covariance = refined.normal.covariance()
    (variance,) = np.diagonal(covariance)[refined.columns_of(slice(0, 1))]
    assert len(covariance) > 4  # of 8 episodes, fewer than half would be left
    freedom = 4
    reach = (strength.high - strength.value) / np.sqrt(variance)
    assert reach == pytest.approx(stats.t.ppf(0.975, freedom))

"""Evidence for effects beside a fit, and what is tied with the best of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from adr_service.criticism import weighing
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.evidence import gained, held_out_without
from adr_service.criticism.fits import refine
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.weighing import (
    Weighed,
    close_to_best,
    from_elsewhere,
    missed,
    single_places,
    slots,
    weigh,
)
from adr_service.effects.base import Effect
from adr_service.effects.catalogue import get_mechanism


def weighed(fit, *effects, gains=None):
    return Weighed(effects, fit, fit.held_out if gains is None else gains, 1.0)


def test_effects_of_a_fit_belong_to_those_that_were_named(refined, friction):
    single, pair = weighed(refined, friction), weighed(refined, friction, friction)
    assert slots([(pair, single), (single,)]) == [slice(0, 2), slice(2, 3)]
    assert slots([]) == []


def test_a_group_is_worth_less_than_a_single_place_with_the_same_gain(refined, friction):
    single, pair = weighed(refined, friction), weighed(refined, friction, friction)
    assert single.fair_gain == single.gain == pair.gain
    assert pair.fair_gain == pair.gain - THRESHOLD


def test_the_best_of_the_places_come_first_and_groups_are_no_places(candidates, friction):
    single = single_places(candidates)
    first = single[0].kind
    assert friction.kind in (first, get_mechanism(first).includes)
    assert all(len(candidate.effects) == 1 for candidate in single)
    assert [c.gain for c in single] == sorted((c.gain for c in single), reverse=True)
    close = close_to_best(single)
    assert close == single[: len(close)]
    assert close[-1].gain > 0.9 * single[0].gain
    assert close_to_best([]) == []


def test_the_hidden_effect_is_weighed_above_another(baseline, friction):
    other = Effect("joint_coulomb_friction", "joint:shoulder", (0.01,))
    rng = np.random.default_rng(0)
    (best,), chance = weigh(baseline, [(other,), (friction,)], rng, lambda: None)
    assert best.effects == (friction,)
    assert chance < 0.01


def test_what_includes_the_best_takes_no_confidence_from_it(baseline, friction):
    more = Effect("joint_stribeck_friction", "joint:elbow", (0.1, 0.001))
    alike, _ = weigh(baseline, [(friction,), (more,)], np.random.default_rng(0), lambda: None)
    assert [each.effects for each in alike] == [(friction,)]
    assert alike[0].confidence > 0.99


def test_the_best_is_refined_though_it_starts_far_beside_its_strength(baseline, friction):
    """At ten times its strength it explains less than nothing."""
    rng, far = np.random.default_rng(0), replace(friction, values=(10 * friction.values[0],))
    (best,), _ = weigh(baseline, [(far,)], rng, lambda: None)
    assert best.newest[0].values == pytest.approx(friction.values, rel=0.1)


def test_what_is_far_below_the_best_at_a_first_look_is_not_refined(baseline, candidates, friction):
    single = single_places(candidates)
    elsewhere = (each for each in single if each.effects[0].location != friction.location)
    other = next(each for each in elsewhere if each.gain < 0.3 * single[0].gain)
    rng, steps = np.random.default_rng(0), []
    weigh(baseline, [other.effects, (friction,)], rng, lambda: steps.append("alive"))
    assert len(steps) == 3  # two looks, and one refinement


def test_what_acts_where_the_best_does_is_refined_however_far_below_it(
    baseline, candidates, friction
):
    """Twenty times the friction explains less than nothing, before it is refined."""
    rivals = (each for each in candidates if each.location == friction.location)
    other = next(each for each in rivals if each.kind == "joint_quadratic_friction")
    far, rng = replace(friction, values=(20 * friction.values[0],)), np.random.default_rng(0)
    (best,), _ = weigh(baseline, [other.effects, (far,)], rng, lambda: None)
    assert best.effects == (far,)
    assert best.newest[0].values == pytest.approx(friction.values, rel=0.1)


def test_beside_a_best_one_that_stays_hopeless_no_other_is_refined(baseline):
    others = [(Effect("joint_spring", "joint:shoulder", (1e-6,)),)] * 3  # as good as each other
    rng, steps = np.random.default_rng(0), []
    assert weigh(baseline, others, rng, lambda: steps.append("alive")) == ((), 1.0)
    assert len(steps) == len(others) + 1


def test_without_evidence_nothing_is_the_best(baseline):
    rng = np.random.default_rng(0)
    other = Effect("joint_coulomb_friction", "joint:shoulder", (0.001,))
    assert weigh(baseline, [(other,)], rng, lambda: None)[0] == ()
    assert weigh(baseline, [], rng, lambda: None) == ((), 1.0)


def test_what_is_missed_without_an_effect_is_what_it_explains(refined, friction):
    current = smoothed(refined)
    whole = held_out_without(current, ())
    alone = missed(weighed(refined, friction), [0], current, whole)
    assert alone.effects == current.effects
    assert alone.gain > 10 * THRESHOLD


def test_other_starts_of_a_strength_stay_where_they_make_sense(baseline):
    """Twice a loss of .6 of the inertia would be a negative one."""
    lost = refine(baseline, [Effect("body_inertia", "body:fore", (-0.6,))])
    beyond = replace(lost, effects=(replace(lost.effects[0], values=(-0.6,)),))
    best = from_elsewhere(baseline, beyond)
    assert best.held_out.sum() >= beyond.held_out.sum()
    assert best.effects[0].values[0] >= -1.0


def test_candidates_are_weighed_beside_misfit_that_persists(pushed_and_rubbing):
    friction = Effect("joint_coulomb_friction", "joint:joint1", (5.0,))
    asked = [[friction], [replace(friction, kind="joint_viscous_friction")]]
    alike, _ = weigh(pushed_and_rubbing, asked, np.random.default_rng(0), lambda: None)
    assert [each.effects[0].kind for each in alike] == ["joint_coulomb_friction"]
    expected = gained(alike[0].fit, pushed_and_rubbing.settled).sum()
    assert alike[0].gain == pytest.approx(expected)
    assert alike[0].gain < 0.9 * (alike[0].fit.held_out - pushed_and_rubbing.held_out).sum()


@pytest.mark.parametrize(
    ("whole", "half", "started"),
    [
        (100.0, 200.0, 0.2),
        (11.0, 69.0, 0.1),
        (-5.0, 10.0, 0.1),
        (11.0, 3.0, 0.2),
        (-5.0, -9.0, 0.2),
    ],
)
def test_strengths_that_are_no_evidence_are_looked_at_again_at_half(
    whole, half, started, friction, monkeypatch
):
    gains = {0.2: whole, 0.1: half}

    def tried(fit, effects):
        return SimpleNamespace(
            effects=tuple(effects), held_out=np.array([gains[effects[0].values[0]]])
        )

    monkeypatch.setattr(weighing, "tried", tried)
    effects = [replace(friction, values=(0.2,))]
    look = weighing._first_look(SimpleNamespace(effects=()), effects, np.zeros(1))
    assert look.fit.effects[0].values == (started,)
    assert look.gain == gains[started]
    assert look.effects == tuple(effects)

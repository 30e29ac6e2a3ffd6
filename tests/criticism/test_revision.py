"""Named effects that others make superfluous, replace or narrow."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism import revision
from adr_service.criticism.decision import THRESHOLD
from adr_service.criticism.fits import fit, refine
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.responses import Responses
from adr_service.criticism.revision import determined, narrowed, pruned, reconsidered
from adr_service.criticism.simulator import Simulator
from adr_service.criticism.weighing import Weighed
from adr_service.effects.base import Effect
from tests.hidden import arm

SPRING = Effect("joint_spring", "joint:elbow", (0.05,))
ELSEWHERE = Effect("joint_coulomb_friction", "joint:shoulder", (0.001,))
STAND_IN = Effect("joint_viscous_friction", "joint:elbow", (0.01,))
BIASES = tuple(
    Effect("sensor_bias", f"sensor:{joint}.{column}", (0.01,))
    for joint in ("shoulder", "elbow")
    for column in ("position", "velocity")
)


@pytest.fixture(scope="module")
def both(baseline, friction):
    """A fit with the friction, and with a spring that the data do not have."""
    return refine(baseline, [SPRING, friction])


def weighed(fit, *effects, gains=None):
    return Weighed(effects, fit, fit.held_out if gains is None else gains, 1.0)


def test_an_effect_that_the_others_make_superfluous_is_dropped(both, friction):
    named = [(weighed(both, SPRING),), (weighed(both, friction),)]
    (kept,), final = pruned(named, both)
    assert kept[0].effects == (friction,)
    assert [effect.kind for effect in final.effects] == [friction.kind]


def test_an_effect_whose_interval_holds_zero_goes_and_the_others_stay(baseline, friction):
    """However large the gain with which it was named."""
    both = refine(baseline, [ELSEWHERE, friction])
    much = np.full(len(both.held_out), 10.0)
    named = [(weighed(both, ELSEWHERE, gains=much),), (weighed(both, friction, gains=much),)]
    (kept,), final, (gone,) = determined(named, both)
    assert (gone.kind, gone.location) == (ELSEWHERE.kind, ELSEWHERE.location)
    assert kept[0].effects == (friction,)
    assert [effect.kind for effect in final.effects] == [friction.kind]


def test_an_effect_that_another_includes_is_dropped_and_the_other_does_its_work():
    """Coulomb friction was named first; beside it, nothing can be said of what the other has of
    it."""
    whole = Effect("joint_position_dependent_friction", "joint:shoulder", (0.15, -0.06, 0.07, 20.0))
    data = hide(*arm(), np.random.default_rng(407), [whole]).episodes(range(8))
    coulomb = Effect("joint_coulomb_friction", whole.location, whole.values[:1])
    rest = replace(whole, values=(0.0, *whole.values[1:]))
    with Simulator(arm()[1], data, threads=1, finer=3) as simulator:
        both = smoothed(refine(smoothed(fit(simulator, data.sensor_variance())), [coulomb, rest]))
        named = [(weighed(both, effect),) for effect in both.effects]
        kept, final = pruned(named, both)
    assert kept == [named[1]]
    assert final.effects[0].kind == whole.kind
    np.testing.assert_allclose(final.effects[0].values[:3], whole.values[:3], rtol=0.1)


@pytest.mark.slow
def test_an_effect_without_which_nothing_can_be_simulated_stays_and_others_go(
    baseline, friction, monkeypatch
):
    both = refine(baseline, [ELSEWHERE, friction])
    named = [(weighed(both, friction),), (weighed(both, ELSEWHERE),)]
    whole = replace(both, effects=both.effects[::-1])
    monkeypatch.setattr(revision, "may_be_nothing", lambda fit, slot: True)
    without = iter([None, refine(baseline, [friction]), None])
    monkeypatch.setattr(revision, "_without", lambda gone, fit: next(without))
    kept, _, gone = determined(named, whole)
    assert len(kept) == len(gone) == 1


def test_effects_whose_strengths_are_sure_all_stay(refined, friction):
    named = [(weighed(refined, friction),)]
    kept, final, gone = determined(named, refined)
    assert (kept, gone) == (named, ())
    assert final is refined


def test_a_single_effect_is_neither_pruned_nor_narrowed(refined, friction):
    named = [(weighed(refined, friction),)]
    for change in (pruned, narrowed):
        kept, final = change(named, refined)
        assert kept == named
        assert final is refined


def test_a_group_is_narrowed_to_the_place_that_needs_it(baseline, friction):
    """The friction is at the elbow alone."""
    fit = refine(baseline, [SPRING, ELSEWHERE, friction])
    named = [(weighed(fit, SPRING),), (weighed(fit, ELSEWHERE, friction),)]
    (first, (single,)), final = narrowed(named, fit)
    assert first == named[0]
    assert [effect.location for effect in single.effects] == [friction.location]
    assert [effect.location for effect in final.effects] == [SPRING.location, friction.location]


def test_a_group_that_needs_two_places_of_four_becomes_two_causes():
    """Both velocities are shown with a bias, and no position."""
    hidden = [replace(bias, values=(0.05,)) for bias in BIASES if "velocity" in bias.location]
    data = hide(*arm(), np.random.default_rng(406), hidden).episodes(range(12))
    sensor = data.sensor_variance()
    with Simulator(arm()[1], data, threads=1, finer=3) as simulator:
        group = smoothed(refine(smoothed(fit(simulator, sensor)), BIASES))
        named, final = narrowed([(weighed(group, *BIASES),)], group)
    assert [[each.effects[0].location for each in alike] for alike in named] == [
        ["sensor:shoulder.velocity"],
        ["sensor:elbow.velocity"],
    ]
    for (alone,), bias in zip(named, hidden, strict=True):
        assert alone.effects[0].values == pytest.approx(bias.values, rel=0.05)
        assert alone.gain > THRESHOLD
    assert len(final.effects) == 2


def test_a_stand_in_is_replaced_by_what_explains_more_beside_the_others(
    baseline, responses, friction
):
    """It was named first; what replaces it stands last."""
    fit = refine(baseline, [STAND_IN, SPRING])
    named = [(weighed(fit, STAND_IN),), (weighed(fit, SPRING),)]
    again, final = asked_again(named, fit, range(1), responses)
    assert again[0] == named[1]
    assert again[1][0].effects[0].kind == friction.kind
    assert [effect.kind for effect in final.effects] == [SPRING.kind, friction.kind]
    assert final.held_out.sum() > fit.held_out.sum() + THRESHOLD


def test_what_still_explains_most_keeps_its_place_and_its_fit(both, responses, friction):
    named = [(weighed(both, SPRING),), (weighed(both, friction),)]
    again, final = asked_again(named, both, range(2), responses)
    assert final is both
    assert [alike[0].effects[0].kind for alike in again] == [SPRING.kind, friction.kind]


@pytest.mark.slow
def test_an_alternative_that_does_worse_beside_the_others_is_tied_no_more(
    baseline, both, responses, friction
):
    worse = weighed(refine(baseline, [ELSEWHERE]), ELSEWHERE)
    named = [(weighed(both, SPRING),), (weighed(both, friction), worse)]
    (_, alike), _ = asked_again(named, both, range(2), responses)
    assert friction.location == alike[0].effects[0].location
    assert ELSEWHERE.location not in [each.effects[0].location for each in alike]


def test_an_alternative_that_is_named_elsewhere_is_tied_no_more(
    baseline, both, responses, friction, monkeypatch
):
    """Also if nothing else comes near."""
    monkeypatch.setattr(revision, "scan", lambda fit, responses: [])
    other = weighed(refine(baseline, [SPRING]), SPRING)
    named = [(weighed(both, SPRING),), (weighed(both, friction), other)]
    (_, alike), _ = asked_again(named, both, range(2), responses)
    assert [each.effects[0].kind for each in alike] == [friction.kind]
    assert alike[0].confidence > 0.99


def test_what_explains_as_much_beside_the_others_is_tied():
    """A biased encoder and a joint whose zero is elsewhere do the same to an arm."""
    hidden = replace(BIASES[2], values=(0.05,)), Effect("joint_spring", "joint:shoulder", (1.0,))
    data = hide(*arm(), np.random.default_rng(408), hidden).episodes(range(12))
    with Simulator(arm()[1], data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, data.sensor_variance()))
        whole = refine(baseline, hidden)
        named = [(weighed(whole, effect),) for effect in hidden]
        (first, _), final = asked_again(named, whole, range(2), Responses(baseline))
    assert final is whole
    assert first[0].effects == (whole.effects[0],)
    assert "joint_reference_offset" in [each.effects[0].kind for each in first[1:]]


@pytest.mark.slow
def test_what_is_not_asked_stays(baseline, responses):
    fit = refine(baseline, [STAND_IN, SPRING])
    named = [(weighed(fit, STAND_IN),), (weighed(fit, SPRING),)]
    again, final = asked_again(named, fit, range(1, 2), responses)
    assert again[0] == named[0]
    assert final.effects[0].kind == STAND_IN.kind


def test_a_group_without_a_tie_is_not_asked_again(baseline, responses, friction):
    fit = refine(baseline, [ELSEWHERE, friction])
    named = [(weighed(fit, ELSEWHERE, friction),)]
    assert asked_again(named, fit, range(1), responses) == (named, fit)


def asked_again(named, fit, which, responses):
    rng = np.random.default_rng(0)
    return reconsidered(named, fit, which, responses, rng, lambda: None)

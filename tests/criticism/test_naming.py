"""The search for effects, one after the other."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.decision import THRESHOLD, is_evidence
from adr_service.criticism.evidence import refine, settled
from adr_service.criticism.naming import (
    Weighed,
    block_of,
    from_elsewhere,
    name_effects,
    narrowed,
    pruned,
    slots,
    still_tied,
)
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import scan
from adr_service.effects.base import Effect
from adr_service.progress import silent

SPRING = Effect("joint_spring", "joint:elbow", (0.05,))
ELSEWHERE = Effect("joint_coulomb_friction", "joint:shoulder", (0.001,))


@pytest.fixture(scope="module")
def search(baseline, sensor):
    """The named effects, the fit with them, and the probability of chance."""
    responses, rng = Responses(baseline), np.random.default_rng(0)
    candidates = scan(baseline, responses)[:8]
    return name_effects(baseline, candidates, responses, None, sensor, rng, silent)


@pytest.fixture(scope="module")
def both(baseline, sensor, friction):
    """A fit with the friction, and with a spring that the data do not have."""
    return refine(baseline, [SPRING, friction], sensor)


def weighed(fit, *effects, gains=None):
    return Weighed(effects, fit, fit.held_out if gains is None else gains, 1.0)


def test_the_only_hidden_effect_is_the_only_one_that_is_named(search, friction):
    (alike,), final, chance = search
    (named,) = alike[0].effects
    assert (named.kind, named.location) == (friction.kind, friction.location)
    assert final.effects[0].values[0] == pytest.approx(friction.values[0], rel=0.1)
    assert chance > 0.99


def test_what_is_named_has_evidence_and_confidence(search, baseline, sensor):
    (alike,), final, _ = search
    assert is_evidence(alike[0].gains)
    assert sum(each.confidence for each in alike) == pytest.approx(1.0, abs=1e-3)
    assert is_evidence(final.held_out - settled(baseline, sensor).held_out)


def test_an_alternative_keeps_its_own_fit(search):
    (alike,), _, _ = search
    for each in alike:
        assert [e.location for e in each.newest] == [e.location for e in each.effects]
        assert each.newest == each.fit.effects


def test_no_candidates_leave_the_fit_as_it_is(baseline, sensor):
    rng = np.random.default_rng(0)
    named, final, chance = name_effects(
        baseline, [], Responses(baseline), None, sensor, rng, silent
    )
    assert (named, chance) == ([], 1.0)
    assert final is baseline


def test_effects_of_a_fit_belong_to_those_that_were_named(refined, friction):
    single, pair = weighed(refined, friction), weighed(refined, friction, friction)
    assert slots([(pair, single), (single,)]) == [slice(0, 2), slice(2, 3)]
    assert slots([]) == []


def test_a_group_is_worth_less_than_a_single_place_with_the_same_gain(refined, friction):
    single, pair = weighed(refined, friction), weighed(refined, friction, friction)
    assert single.fair_gain == single.gain == pair.gain
    assert pair.fair_gain == pair.gain - THRESHOLD


def test_an_effect_that_the_others_make_superfluous_is_dropped(both, sensor, friction):
    named = [(weighed(both, SPRING),), (weighed(both, friction),)]
    (kept,), final = pruned(named, both, sensor)
    assert kept[0].effects == (friction,)
    assert [effect.kind for effect in final.effects] == [friction.kind]


def test_a_single_effect_is_neither_pruned_nor_narrowed(refined, sensor, friction):
    named = [(weighed(refined, friction),)]
    for change in (pruned, narrowed):
        kept, final = change(named, refined, sensor)
        assert kept == named
        assert final is refined
    assert still_tied(named, refined, sensor) == named


def test_a_group_is_narrowed_to_the_place_that_needs_it(baseline, sensor, friction):
    """The friction is at the elbow alone."""
    fit = refine(baseline, [SPRING, ELSEWHERE, friction], sensor)
    named = [(weighed(fit, SPRING),), (weighed(fit, ELSEWHERE, friction),)]
    (first, (single,)), final = narrowed(named, fit, sensor)
    assert first == named[0]
    assert [effect.location for effect in single.effects] == [friction.location]
    assert [effect.location for effect in final.effects] == [SPRING.location, friction.location]


def test_an_alternative_that_does_worse_beside_the_others_is_tied_no_more(
    baseline, both, sensor, friction
):
    worse, same = (
        weighed(refine(baseline, [effect], sensor), effect)
        for effect in (ELSEWHERE, replace(friction, values=(0.08,)))
    )
    named = [(weighed(both, SPRING),), (weighed(both, friction), worse, same)]
    _, (best, *others) = still_tied(named, both, sensor)
    assert best == named[1][0]
    assert others == [same]


def test_an_alternative_that_is_named_elsewhere_is_tied_no_more(baseline, both, sensor, friction):
    other = weighed(refine(baseline, [SPRING], sensor), SPRING)
    named = [(weighed(both, SPRING),), (weighed(both, friction), other)]
    assert still_tied(named, both, sensor)[1] == named[1][:1]


@pytest.fixture(scope="module")
def block(baseline, sensor, friction):
    """The friction and a spring that the data do not have, together."""
    return block_of(baseline, ((friction,), (SPRING,)), sensor)


def named_from(block, baseline, sensor):
    responses, rng = Responses(baseline), np.random.default_rng(0)
    candidates = scan(baseline, responses)[:8]
    return name_effects(baseline, candidates, responses, block, sensor, rng, silent)[:2]


def test_a_block_that_gains_no_more_than_one_effect_alone_is_not_taken(
    block, search, baseline, sensor
):
    named, _ = named_from(block, baseline, sensor)
    kinds = [[alike[0].effects[0].kind for alike in each] for each in (named, search[0])]
    assert kinds[0] == kinds[1]


def test_a_group_that_the_others_make_superfluous_does_not_stand_and_takes_no_evidence(
    block, baseline, sensor, friction
):
    far = replace(block, gains=10 * block.gains)  # as if it explained much more
    named, current = named_from(far, baseline, sensor)
    (first,) = named[0]
    assert first.effects[0].kind == friction.kind
    assert first.effects[0].values == pytest.approx(friction.values, rel=0.05)
    assert is_evidence(first.gains)
    assert first.confidence > 0.99
    assert SPRING.kind not in [effect.kind for effect in current.effects]


def test_nothing_is_no_block(baseline, sensor):
    assert block_of(baseline, (), sensor) is None


def test_other_starts_of_a_strength_stay_where_they_make_sense(baseline, sensor):
    """Twice a loss of .6 of the inertia would be a negative one."""
    lost = refine(baseline, [Effect("body_inertia", "body:fore", (-0.6,))], sensor)
    beyond = replace(lost, effects=(replace(lost.effects[0], values=(-0.6,)),))
    best = from_elsewhere(baseline, beyond, sensor)
    assert best.held_out.sum() >= beyond.held_out.sum()
    assert best.effects[0].values[0] >= -1.0

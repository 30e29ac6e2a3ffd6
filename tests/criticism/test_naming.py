"""The search for effects, one after the other."""

from dataclasses import replace

import numpy as np
import pytest

from adr_service.criticism.decision import is_evidence
from adr_service.criticism.evidence import gained
from adr_service.criticism.fits import refine, tried
from adr_service.criticism.naming import block_of, name_effects
from adr_service.criticism.probable_states import linearised
from adr_service.effects.base import Effect
from adr_service.progress import silent

SPRING = Effect("joint_spring", "joint:elbow", (0.05,))


@pytest.fixture(scope="module")
def search(baseline, candidates, responses):
    """The named effects, the fit with them, and the probability of chance."""
    rng = np.random.default_rng(0)
    return name_effects(baseline, candidates[:8], responses, None, rng, silent)


def test_the_only_hidden_effect_is_the_only_one_that_is_named(search, friction):
    (alike,), final, chance = search
    (named,) = alike[0].effects
    assert (named.kind, named.location) == (friction.kind, friction.location)
    assert final.effects[0].values[0] == pytest.approx(friction.values[0], rel=0.1)
    assert chance > 0.99


def test_what_is_named_has_evidence_and_confidence(search, baseline):
    (alike,), final, _ = search
    assert is_evidence(alike[0].gains)
    # the rest is that of Stribeck friction, which is this one and more
    assert sum(each.confidence for each in alike) == pytest.approx(1.0, abs=1e-2)
    assert is_evidence(final.held_out - baseline.settled.held_out)


def test_an_alternative_keeps_its_own_fit(search):
    (alike,), _, _ = search
    for each in alike:
        assert [e.location for e in each.newest] == [e.location for e in each.effects]
        assert each.newest == each.fit.effects


def test_no_candidates_leave_the_fit_as_it_is(baseline, responses):
    rng = np.random.default_rng(0)
    named, final, chance = name_effects(baseline, [], responses, None, rng, silent)
    assert (named, chance) == ([], 1.0)
    assert final is baseline


@pytest.fixture(scope="module")
def block(baseline, friction):
    """The friction and a spring that the data do not have, together."""
    return block_of(baseline, ((friction,), (SPRING,)))


@pytest.fixture
def named_from(baseline, candidates, responses):
    def search(block):
        rng = np.random.default_rng(0)
        return name_effects(baseline, candidates[:8], responses, block, rng, silent)[:2]

    return search


@pytest.mark.slow
def test_a_block_that_gains_no_more_than_one_effect_alone_is_not_taken(block, search, named_from):
    named, _ = named_from(block)
    kinds = [[alike[0].effects[0].kind for alike in each] for each in (named, search[0])]
    assert kinds[0] == kinds[1]


def test_a_group_that_the_others_make_superfluous_does_not_stand_and_takes_no_evidence(
    block, friction, named_from
):
    far = replace(block, gains=10 * block.gains)  # as if it explained much more
    named, current = named_from(far)
    (first,) = named[0]
    assert first.effects[0].kind == friction.kind
    assert first.effects[0].values == pytest.approx(friction.values, rel=0.05)
    assert is_evidence(first.gains)
    assert first.confidence > 0.99
    assert SPRING.kind not in [effect.kind for effect in current.effects]


def test_a_block_gains_nothing_by_better_states(baseline, friction):
    """Better states gain without any effect: here the first ones are half a radian off."""
    nowhere = np.zeros(len(baseline.held_out))
    start = linearised(replace(baseline, states=baseline.states + 0.5), nowhere)
    assert (start.settled.held_out - start.held_out).sum() > 1000
    alone = gained(refine(baseline, [friction]), baseline.settled).sum()
    assert 0 < block_of(start, ((friction,),)).gains.sum() < 1.1 * alone


def test_nothing_is_no_block(baseline):
    assert block_of(baseline, ()) is None


def test_strengths_that_predict_worse_than_nothing_are_no_block(baseline, friction):
    far_off = replace(SPRING, values=(50.0,))
    assert tried(baseline, [friction, far_off]).held_out.sum() < baseline.held_out.sum()
    assert block_of(baseline, ((friction,), (far_off,))) is None

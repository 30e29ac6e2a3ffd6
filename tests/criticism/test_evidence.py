"""Evidence for effects: gains on episodes that were left out."""

import numpy as np
import pytest

from adr_service.criticism.decision import is_evidence
from adr_service.criticism.evidence import gained, held_out_without
from adr_service.criticism.fits import refine
from adr_service.effects.base import Effect


def test_a_missing_effect_gains_evidence_on_left_out_episodes(baseline, refined):
    without = baseline.settled.held_out
    assert is_evidence(refined.held_out - without)


def test_an_effect_is_missed_as_much_by_linearisation_as_when_all_is_refined(refined):
    rests = held_out_without(refined, [0]), refine(refined, []).held_out
    roughly, exactly = ((refined.held_out - rest).sum() for rest in rests)
    assert exactly > 200
    assert roughly == pytest.approx(exactly, rel=0.2)


def test_evidence_counts_beside_misfit_that_persists(pushed_and_rubbing):
    baseline = pushed_and_rubbing
    friction = Effect("joint_coulomb_friction", "joint:joint1", (5.0,))
    refined = refine(baseline, [friction])
    assert refined.persistence.share == 0.7  # drawn: 0.8
    exactly = gained(refined, baseline.settled).sum()
    assert 1000 < exactly < 0.9 * (refined.held_out - baseline.settled.held_out).sum()
    roughly = (held_out_without(refined, []) - held_out_without(refined, [0])).sum()
    assert roughly == pytest.approx(exactly, rel=0.1)


def test_where_misfit_does_not_persist_evidence_is_what_is_left_out(baseline, refined):
    assert refined.persistence.share == 0
    np.testing.assert_array_equal(
        gained(refined, baseline.settled), refined.held_out - baseline.settled.held_out
    )

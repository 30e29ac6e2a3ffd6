"""Strengths that a recording cannot tell apart."""

import numpy as np
import pytest

from adr_service.blind_test.planting import hide
from adr_service.criticism.fits import fit
from adr_service.criticism.identifiability import indistinguishable
from adr_service.criticism.probable_states import smoothed
from adr_service.criticism.responses import Responses
from adr_service.criticism.scan import scan
from adr_service.criticism.simulator import Simulator
from adr_service.effects.base import Effect
from tests.hidden import arm


@pytest.fixture(scope="module")
def looked():
    """A fit to an arm whose fore arm is heavier than its model says, its candidates, and groups."""
    hidden = [Effect("body_mass", "body:fore", (0.2,))]
    task, nominal = arm()
    data = hide(task, nominal, np.random.default_rng(402), hidden).episodes(range(12))
    with Simulator(nominal, data, threads=1, finer=3) as simulator:
        baseline = smoothed(fit(simulator, data.sensor_variance()))
        responses = Responses(baseline)
        candidates = scan(baseline, responses)
        yield candidates, indistinguishable(baseline, responses, candidates)


def group_of(looked, name):
    return next((group for group in looked[1] if name in group), ())


def test_where_one_of_a_group_is_hidden_all_of_it_gain_the_same(looked):
    group = group_of(looked, "body_mass body:fore")
    assert "body_inertia body:fore" in group  # about the joint, in a plane
    alone = {f"{c.kind} {c.location}": c for c in looked[0] if len(c.effects) == 1}
    gains = [alone[name].gain for name in group if name in alone]
    assert min(gains) > 100
    assert min(gains) > 0.97 * max(gains)


def test_strengths_that_move_the_robot_differently_are_in_no_group_together(looked):
    assert group_of(looked, "joint_coulomb_friction joint:elbow") == ()
    masses = group_of(looked, "body_mass body:fore")
    load = group_of(looked, "body_load body:upper moment z")
    assert "body_inertia body:upper" in load  # of a load's four strengths two can be seen
    assert not any("friction" in name or "sensor" in name for name in masses)


def test_a_mechanism_that_includes_another_is_not_listed_with_it(looked):
    """Stribeck friction that does not fall with speed is Coulomb friction, by construction."""
    assert not any("stribeck" in name for group in looked[1] for name in group)


def test_without_candidates_there_is_nothing_to_tell_apart(looked, baseline):
    assert indistinguishable(baseline, Responses(baseline), []) == ()

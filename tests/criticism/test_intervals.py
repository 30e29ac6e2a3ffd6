"""Intervals of strengths, and whether they hold zero."""

from types import SimpleNamespace

import numpy as np
import pytest

from adr_service.criticism.fits import refine
from adr_service.criticism.intervals import intervals, may_be_nothing
from adr_service.effects.base import Effect

ABSENT = Effect("joint_coulomb_friction", "joint:shoulder", (0.001,))
FRICTION = slice(1, 2)


@pytest.fixture(scope="module")
def both(baseline, friction):
    """A fit with a friction that the data do not have, and with one that they do."""
    return refine(baseline, [ABSENT, friction])


def test_a_strength_that_is_there_is_not_nothing(both):
    (strength,) = intervals(both, FRICTION)
    assert 0 < strength.low < strength.value < strength.high
    assert not may_be_nothing(both, FRICTION)


def test_a_strength_that_is_not_there_may_be_nothing(both):
    (strength,) = intervals(both, slice(0, 1))
    assert strength.low <= 0 < strength.high
    assert may_be_nothing(both, slice(0, 1))


def test_a_group_is_something_if_one_of_its_places_is(both):
    assert not may_be_nothing(both, slice(0, 2))


@pytest.mark.parametrize(("correlation", "is_nothing"), [(-0.99, False), (0.0, True)])
def test_two_strengths_may_be_sure_together_that_are_unsure_apart(
    correlation, is_nothing, baseline
):
    """Each is 1.5 of its deviations away from zero; of their sum that is 21 if they trade."""
    frictions = tuple(
        Effect("joint_coulomb_friction", f"joint:{joint}", (1.5,))
        for joint in ("shoulder", "elbow")
    )
    covariance = np.array([[1.0, correlation], [correlation, 1.0]])
    fit = SimpleNamespace(
        simulator=baseline.simulator,
        effects=frictions,
        normal=SimpleNamespace(covariance=lambda: covariance, freedom=38),
        columns_of=lambda slot: slot,
    )
    assert may_be_nothing(fit, slice(0, 2)) == is_nothing
    assert may_be_nothing(fit, slice(0, 1))


def test_a_shape_does_not_make_something_of_nothing(baseline):
    """Ripple of a joint that has none: its waves in a turn are many, and its forces none."""
    ripple = Effect("joint_torque_ripple", "joint:shoulder", (0.001, 0.001, 40.0))
    fit = refine(baseline, [ripple])
    *forces, waves = intervals(fit, slice(0, 1))
    assert all(force.low <= 0 <= force.high for force in forces)
    assert waves.low > 0
    assert may_be_nothing(fit, slice(0, 1))

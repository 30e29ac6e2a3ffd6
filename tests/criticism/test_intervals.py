"""Intervals of strengths, and whether they hold zero."""

import pytest

from adr_service.criticism.evidence import refine
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


def test_a_shape_does_not_make_something_of_nothing(baseline):
    """Ripple of a joint that has none: its waves in a turn are many, and its forces none."""
    ripple = Effect("joint_torque_ripple", "joint:shoulder", (0.001, 0.001, 40.0))
    fit = refine(baseline, [ripple])
    *forces, waves = intervals(fit, slice(0, 1))
    assert all(force.low <= 0 <= force.high for force in forces)
    assert waves.low > 0
    assert may_be_nothing(fit, slice(0, 1))

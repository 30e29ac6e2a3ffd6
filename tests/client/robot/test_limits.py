"""Limits of a robot's owner."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adr_service.client.robot.limits import Limits
from adr_service.errors import InvalidInput

numbers = st.floats(-1e6, 1e6)


@given(st.lists(numbers, min_size=3, max_size=3), st.floats(0.01, 100))
def test_an_action_is_the_nearest_within_the_limits(action, most):
    limits = Limits(actions=(most,))
    applied = limits.apply(np.array(action))
    assert np.all(np.abs(applied) <= most)
    np.testing.assert_array_equal(limits.apply(applied), applied)
    inside = np.abs(action) <= most
    np.testing.assert_array_equal(applied[inside], np.array(action)[inside])


def test_each_action_may_have_a_limit_of_its_own():
    applied = Limits(actions=(0.5, 2.0)).apply(np.array([-1.0, -1.0]))
    assert applied.tolist() == [-0.5, -1.0]


def test_without_limits_everything_is_allowed():
    action = np.array([1e9])
    assert Limits().apply(action) is action
    assert Limits().allows(1e9)


def test_a_step_has_the_time_that_is_left_of_the_episode():
    assert Limits().left(1e6, 0.02) == Limits().left(0.0, 0.02)
    limits = Limits(seconds=5.0)
    assert limits.allows(5.0)
    assert not limits.allows(5.1)
    assert limits.left(4.0, 0.02) - limits.left(4.5, 0.02) == pytest.approx(0.5)


def test_the_last_step_of_a_slow_robot_has_time_to_end():
    assert Limits(seconds=20.0).left(19.8, 2.0) > 2.2  # it is late by a tenth


def test_a_long_episode_leaves_a_step_no_more_time_than_a_step_may_take():
    assert Limits(seconds=1e4).left(0.0, 0.02) == Limits().left(0.0, 0.02)


@pytest.mark.parametrize("seconds", [0.0, -1.0, np.nan, np.inf])
def test_a_time_that_no_episode_and_no_reset_can_take_is_refused(seconds):
    with pytest.raises(InvalidInput, match="an episode takes a positive and finite time; given"):
        Limits(seconds=seconds)
    with pytest.raises(InvalidInput, match="a reset takes a positive and finite time; given"):
        Limits(reset_seconds=seconds)

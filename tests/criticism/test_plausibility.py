"""Checks of a measurement by itself."""

import numpy as np
import pytest

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.plausibility import check_rates, check_usable
from adr_service.errors import InvalidInput


def test_too_few_episodes_are_refused(good):
    with pytest.raises(InvalidInput, match="in 7 episodes are too few"):
        check_usable(Measurement(**good).episodes(range(7)))


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        ("qpos", lambda v: 0 * v + 0.5, "qpos, column 1, is 0.5 in all rows"),
        ("qvel", lambda v: np.minimum(v, np.quantile(v, 0.7)), "qvel, column 1, is saturated"),
    ],
)
def test_a_sensor_that_is_stuck_is_named(good, name, spoil, message):
    spoiled = good[name].copy()
    spoiled[:, 1] = spoil(spoiled[:, 1])
    with pytest.raises(InvalidInput, match=message):
        check_usable(Measurement(**{**good, name: spoiled}))
    # a column without readings may hold anything
    unread = np.where(np.arange(2) == 1, np.inf, 0.01)
    check_usable(Measurement(**{**good, name: spoiled, f"{name}_std": unread}))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("time", lambda a: 2 * a, "column 0 of qpos moves 0.5 times as far as"),
        ("qvel", np.degrees, "qpos moves 0.0175 times as far"),
        ("qvel", np.negative, r"qpos moves against .* correlation is -1.00\): the sign"),
    ],
)
def test_velocities_that_are_not_the_rates_of_positions_are_refused(good, name, change, message):
    measurement = Measurement(**{**good, name: change(good[name])})
    with pytest.raises(InvalidInput, match=message):
        check_rates(measurement)


def test_a_joint_of_which_nothing_is_measured_is_refused(good):
    unread = [0.1, np.inf]
    measurement = Measurement(**good, qpos_std=unread, qvel_std=unread)
    with pytest.raises(InvalidInput, match="column 1 is measured neither in qpos nor in qvel"):
        check_rates(measurement)


@pytest.mark.parametrize("unread", [(), ("qpos",), ("qvel",), ("qpos", "qvel")])
def test_a_joint_that_never_moves_is_refused_with_the_way_out(good, unread):
    """Neither another column nor a deviation that is infinite would help."""
    qpos, qvel = good["qpos"].copy(), good["qvel"].copy()
    qpos[:, 1], qvel[:, 1] = 0.5, 0.0
    known = {f"{name}_std": [np.nan, np.inf] for name in unread}
    with pytest.raises(InvalidInput, match=r"column 1 is constant in qpos \(0.5\).*weld it"):
        check_usable(Measurement(**{**good, "qpos": qpos, "qvel": qvel}, **known))

"""Checks of a measurement by itself."""

from contextlib import nullcontext

import numpy as np
import pytest
from scipy.signal import lfilter

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.plausibility import check_rates, check_usable
from adr_service.errors import InvalidInput


def test_too_few_episodes_are_refused(good):
    with pytest.raises(InvalidInput, match="in 7 episodes are too few"):
        check_usable(Measurement(**good).episodes(range(7)))


@pytest.mark.parametrize(("rows", "is_enough"), [(25, False), (26, True)])
def test_eight_episodes_need_two_hundred_transitions(good, rows, is_enough):
    spans = Measurement(**good).spans()[:8]
    kept = np.concatenate([np.arange(first, first + rows) for first, _ in spans])
    data = Measurement(**{name: values[kept] for name, values in good.items()})
    refusal = pytest.raises(InvalidInput, match="192 transitions in 8 episodes are too few")
    with nullcontext() if is_enough else refusal:
        check_usable(data)


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        ("qpos", lambda v: 0 * v + 0.5, "qpos, column 1, is 0.5 in all rows"),
        (
            "qvel",
            lambda v: np.minimum(v, np.quantile(v, 0.7)),
            "qvel, column 1, is saturated.* begin a new episode after",
        ),
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


def drawn(good, rng):
    return rng.normal(scale=good["qvel"][:, 1].std() / 2, size=len(good["qvel"]))


@pytest.mark.parametrize(
    "other",
    [
        lambda good, rng: good["qvel"][:, 0],
        lambda good, rng: good["qpos"][:, 1],
        lambda good, rng: good["ctrl"][:, 0],
        drawn,
    ],
    ids=["another joint's velocity", "the position", "a command", "random numbers"],
)
def test_a_velocity_that_has_nothing_to_do_with_its_position_is_refused(good, other):
    qvel = good["qvel"].copy()
    qvel[:, 1] = other(good, np.random.default_rng(0))
    with pytest.raises(InvalidInput, match=r"column 1 of qpos moves, but not as .* order"):
        check_rates(Measurement(**{**good, "qvel": qvel}))


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("qvel", lambda v, rng: v + 10 * rng.normal(scale=v.std(), size=v.shape)),
        ("qvel", lambda v, rng: v + 1.4 * rng.normal(scale=v.std(), size=v.shape)),
        ("qpos", lambda v, rng: v + 3 * rng.normal(scale=v.std(), size=v.shape)),
        ("qpos", lambda v, rng: np.round(v / np.ptp(v))),
        ("qvel", lambda v, rng: np.where(rng.uniform(size=v.shape) < 0.01, 1e4, v)),
        ("qpos", lambda v, rng: np.where(rng.uniform(size=v.shape) < 0.01, 1e4, v)),
    ],
    ids=[
        "velocities in noise",
        "noisy velocities",
        "noisy positions",
        "a coarse encoder",
        "velocity spikes",
        "spikes",
    ],
)
def test_poor_readings_of_the_right_joint_are_no_wrong_columns(good, name, spoil):
    values = good[name].copy()
    values[:, 1] = spoil(values[:, 1], np.random.default_rng(0))
    check_rates(Measurement(**{**good, name: values}))


def filtered(noise, keep):
    """Noise (n,) after a filter of first order, as drives have, with its deviation kept."""
    return lfilter([np.sqrt(1 - keep**2)], [1, -keep], noise)


@pytest.mark.parametrize(
    ("reach", "position", "velocity"),
    [(0.005, 1e-5, 0.02), (0.0, 1e-4, 0.005)],
    ids=["a slow motion", "a joint at rest"],
)
def test_filtered_noise_of_a_quiet_joint_is_no_wrong_column(reach, position, velocity):
    for seed in range(8):
        rng, time = np.random.default_rng(seed), np.tile(np.arange(75) * 0.01, 30)
        episode = np.repeat(np.arange(30), 75)
        angle = 1.26 * time + rng.uniform(0, 6, 30)[episode]
        q = reach * np.sin(angle) + position * filtered(rng.normal(size=len(time)), 0.9)
        v = 1.26 * reach * np.cos(angle) + velocity * filtered(rng.normal(size=len(time)), 0.8)
        columns = {"qpos": q[:, None], "qvel": v[:, None], "ctrl": np.zeros((len(time), 1))}
        check_rates(Measurement(time=time, episode=episode, **columns))


def test_a_joint_that_turns_at_one_speed_is_no_wrong_column(good):
    """Displacements that are all alike correlate with nothing."""
    rng, time = np.random.default_rng(0), np.arange(len(good["time"])) * 0.02
    qpos, qvel = good["qpos"].copy(), good["qvel"].copy()
    qpos[:, 1] = 2.0 * time + rng.normal(scale=1e-3, size=len(time))
    qvel[:, 1] = 2.0 + rng.normal(scale=1e-2, size=len(time))
    check_rates(Measurement(**{**good, "qpos": qpos, "qvel": qvel}))


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

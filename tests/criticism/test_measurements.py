"""Measurements: accepted arrays, and refusals that say what is wrong."""

import numpy as np
import pytest

from adr_service.criticism import measurements
from adr_service.criticism.measurements import Measurement, is_measurement
from adr_service.errors import InvalidInput
from adr_service.npz import write_arrays


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("qvel", lambda a: a[:-1], "qvel has shape .* expected are 2280 rows"),
        ("qpos", lambda a: np.where(np.arange(len(a))[:, None] == 5, np.nan, a), "row 5"),
        ("episode", lambda a: a[::-1], "must not decrease; they do at row 76"),
        ("episode", lambda a: a[::-1].astype(np.uint8), "must not decrease; they do at row 76"),
        ("episode", lambda a: a.astype(float), "whole numbers"),
        ("time", lambda a: a[:, None], "in 1 dimension"),
        (
            "time",
            lambda a: np.where(np.arange(len(a)) == 7, a - 0.1, a),
            "time must increase within an episode; it goes from 0.12 to 0.04 s at row 7",
        ),
        ("time", np.zeros_like, "time must increase"),
        ("time", lambda a: a[0], r"time has shape \(\); expected are 1 rows"),
        ("time", lambda a: 1e300 * a, "time is in seconds, up to 1e.12; given up to"),
        ("ctrl", lambda a: np.zeros((len(a), 1001)), "at most 1000 columns"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_with_the_row(good, name, change, message):
    with pytest.raises(InvalidInput, match=message):
        Measurement(**{**good, name: change(good[name])})


def test_a_measurement_without_rows_is_refused(good):
    with pytest.raises(InvalidInput, match="has no rows"):
        Measurement(**{name: values[:0] for name, values in good.items()})


def test_an_episode_of_one_row_is_refused(good):
    ids = good["episode"].copy()
    ids[-1] += 1
    with pytest.raises(InvalidInput, match="the episode at row 2279 has a single row"):
        Measurement(**{**good, "episode": ids})


def test_one_deviation_stands_for_all_columns(good):
    measurement = Measurement(**good, qpos_std=0.1)
    np.testing.assert_array_equal(measurement.qpos_std, [0.1, 0.1])
    np.testing.assert_array_equal(
        np.isnan(measurement.sensor_variance()), [False, False, True, True]
    )


@pytest.mark.parametrize("given", [[0.1, 0.1, 0.1], [0.1, -0.1]])
def test_deviations_of_another_shape_or_sign_are_refused(good, given):
    with pytest.raises(InvalidInput, match="qvel_std must be 2 numbers that are not negative"):
        Measurement(**good, qvel_std=given)


def test_an_unmeasured_column_has_its_variance_over_the_recording(good):
    measurement = Measurement(**good, qpos_std=[np.inf, 0.1])
    np.testing.assert_array_equal(measurement.is_measured(), [False, True, True, True])
    expected = (measurement.qpos[:, 0].std() + 1e-3) ** 2
    assert measurement.sensor_variance()[0] == pytest.approx(expected, rel=1e-12)


def test_constants_in_unmeasured_columns_give_way_to_what_the_other_column_implies(good):
    """A derivative in place of a velocity, and an integral in place of a position."""
    qpos, qvel, period = good["qpos"].copy(), good["qvel"].copy(), 0.02
    qpos[:, 0], qvel[:, 1] = 0.3, 0.0
    known = {"qpos_std": [np.inf, 0.01], "qvel_std": [0.01, np.inf]}
    completed = Measurement(**{**good, "qpos": qpos, "qvel": qvel}, **known).completed()
    for first, last in completed.spans():
        rows = slice(first, last)
        steps = period * (qvel[first : last - 1, 0] + qvel[first + 1 : last, 0]) / 2
        np.testing.assert_allclose(np.diff(completed.qpos[rows, 0]), steps, atol=1e-12)
        assert completed.qpos[first, 0] == 0.3
        rates = np.gradient(qpos[rows, 1], period)
        np.testing.assert_allclose(completed.qvel[rows, 1], rates, atol=1e-9)
    np.testing.assert_array_equal(completed.qpos[:, 1], qpos[:, 1])
    np.testing.assert_array_equal(completed.qvel[:, 0], qvel[:, 0])


def test_a_constant_may_differ_from_episode_to_episode(good):
    """Each episode is integrated from its own."""
    known = {"qpos_std": [np.inf, 0.01], "qvel_std": [0.01, 0.01]}
    qpos = good["qpos"].copy()
    qpos[:, 0] = np.where(np.asarray(good["episode"]) % 2, 0.3, -0.2)
    completed = Measurement(**{**good, "qpos": qpos}, **known).completed()
    for number, (first, last) in enumerate(completed.spans()):
        assert completed.qpos[first, 0] == (0.3 if number % 2 else -0.2)
        assert np.ptp(completed.qpos[first:last, 0]) > 0


def test_unmeasured_columns_that_change_are_kept(good):
    measurement = Measurement(**good, qpos_std=[np.inf, 0.1], qvel_std=[0.1, np.inf])
    completed = measurement.completed()
    np.testing.assert_array_equal(completed.qpos, measurement.qpos)
    np.testing.assert_array_equal(completed.qvel, measurement.qvel)


def test_chosen_episodes_keep_their_order_and_rows(good):
    measurement = Measurement(**good)
    first, last = measurement.spans()[5]
    chosen = measurement.episodes([2, 5])
    assert chosen.spans() == [(0, 76), (76, 152)]
    np.testing.assert_array_equal(chosen.qpos[76:], measurement.qpos[first:last])


def test_a_deviation_that_is_nan_is_to_be_estimated(good):
    measurement = Measurement(**good, qvel_std=[np.nan, np.inf])
    np.testing.assert_array_equal(measurement.is_measured(), [True, True, True, False])
    assert np.isnan(measurement.sensor_variance()[2])


def test_commands_within_rows_are_cut_and_kept_with_their_rows(good):
    ctrl = np.asarray(good["ctrl"])
    within = ctrl[:, None] + np.array([-0.1, 0.1])[None, :, None]
    measurement = Measurement(**good, ctrl_within=within)
    first, last = measurement.spans()[3]
    np.testing.assert_array_equal(measurement.episodes([3]).ctrl_within, within[first:last])
    again = Measurement.from_npz(measurement.to_npz())
    np.testing.assert_array_equal(again.ctrl_within, within)


@pytest.mark.parametrize("shape", [(2,), (0, 2), (3, 1), (3, 3)])
def test_commands_within_rows_have_a_part_for_each_actuator(good, shape):
    within = np.zeros((len(good["time"]), *shape))
    with pytest.raises(InvalidInput, match=r"ctrl_within has shape .*; expected is .*, k, 2"):
        Measurement(**good, ctrl_within=within)


def test_commands_within_rows_must_have_the_rows_as_their_mean(good):
    within = np.repeat(np.asarray(good["ctrl"])[:, None], 2, axis=1)
    within[5, 1, 0] += 0.1
    with pytest.raises(InvalidInput, match="ctrl must be the mean of ctrl_within"):
        Measurement(**good, ctrl_within=within)


def test_a_file_of_arrays_is_the_same_measurement(good, tmp_path):
    np.savez(tmp_path / "measured.npz", **good)
    content = (tmp_path / "measured.npz").read_bytes()
    assert is_measurement(content)
    np.testing.assert_array_equal(Measurement.from_npz(content).qvel, good["qvel"])


def test_a_file_that_lacks_an_array_is_refused_with_those_it_has(good, tmp_path):
    np.savez(tmp_path / "part.npz", time=good["time"], qpos=good["qpos"])
    with pytest.raises(InvalidInput, match=r"lacks .'qvel', 'ctrl', 'episode'.*'qpos', 'time'"):
        Measurement.from_npz((tmp_path / "part.npz").read_bytes())


def test_episode_numbers_that_cannot_be_kept_are_refused(good):
    late = good["episode"].astype(np.uint64) + np.uint64(2**63)
    with pytest.raises(InvalidInput, match=r"below 2\*\*63; given 92233720368547758"):
        Measurement.from_npz(write_arrays({**good, "episode": late}))


def test_recordings_whose_episode_numbers_are_too_far_apart_together_are_refused(good):
    first, last = good["episode"][[0, -1]]
    far = np.where(good["episode"] == last, 2**63 - 1, good["episode"] - first)
    whole = Measurement(**{**good, "episode": far})
    np.testing.assert_array_equal(Measurement.joined([whole]).episode, far)
    with pytest.raises(
        InvalidInput, match=r"may span 2\*\*63 in all; given are 18446744073709551616"
    ):
        Measurement.joined([whole, whole])


def test_recordings_are_joined_with_episodes_of_their_own(good):
    one = Measurement(**good)
    within = np.repeat(np.asarray(good["ctrl"])[:, None], 2, axis=1)
    two = Measurement(**good, ctrl_within=within).episodes([4, 7])
    both = Measurement.joined([one, two])
    assert len(both.spans()) == len(one.spans()) + 2
    np.testing.assert_array_equal(both.qpos[len(one.time) :], two.qpos)
    np.testing.assert_array_equal(both.ctrl_within[len(one.time) :], two.ctrl_within)
    np.testing.assert_array_equal(both.ctrl_within.mean(axis=1), both.ctrl)
    assert Measurement.joined([one]).ctrl_within is None


def test_a_deviation_that_is_not_given_is_the_same_as_one_to_be_estimated(good):
    silent, asked = Measurement(**good), Measurement(**good, qpos_std=np.nan, qvel_std=np.nan)
    for pair in ((silent, asked), (asked, silent)):
        joined = Measurement.joined(pair)
        assert np.isnan(joined.sensor_variance()).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ctrl": lambda a: a[:, :1]}, "ctrl has 2 in the first and 1 in another"),
        ({"time": lambda a: 2 * a}, "equally far apart; given are"),
        ({"qpos_std": lambda _: [0.1, 0.1]}, "qpos_std is not given in the first"),
        ({"qvel_std": lambda _: [np.nan, np.inf]}, "qvel_std is not given in the first"),
    ],
)
def test_recordings_that_do_not_fit_together_are_refused(good, change, message):
    other = {**good, **{name: make(good.get(name)) for name, make in change.items()}}
    with pytest.raises(InvalidInput, match=message):
        Measurement.joined([Measurement(**good), Measurement(**other)])


def test_too_many_episodes_are_refused(good, monkeypatch):
    monkeypatch.setattr(measurements, "MOST_EPISODES", 29)
    with pytest.raises(InvalidInput, match="29 episodes at most; this has 30"):
        Measurement(**good)


def test_a_file_of_texts_is_refused(good):
    texts = np.array([["a", "b"]] * len(good["time"]))
    with pytest.raises(InvalidInput, match="qvel must hold numbers"):
        Measurement.from_npz(write_arrays({**good, "qvel": texts}))

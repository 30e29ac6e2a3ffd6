"""Measurements that share rows, which would count twice."""

import numpy as np
import pytest

from adr_service.criticism.measurements import Measurement
from adr_service.criticism.overlaps import check_apart
from adr_service.errors import InvalidInput
from adr_service.npz import write_arrays

NAMES = ["first.npz", "second.npz"]


def part(good, chosen, **other):
    rows = {name: values[chosen] for name, values in good.items()}
    return Measurement(**{**rows, **other})


def test_measurements_that_share_rows_are_refused_with_the_rows(good):
    """Times may begin anew, and the episodes be cut elsewhere."""
    period = float(good["time"][1])
    second = part(good, slice(30, 70), time=period * np.arange(40.0), episode=np.arange(40) // 20)
    with pytest.raises(
        InvalidInput, match=r"first\.npz from row 30 on and second\.npz from row 0 on"
    ):
        check_apart(NAMES, [part(good, slice(0, 60)), second])


def test_measurements_of_which_nothing_is_measured_share_nothing(good):
    unknown = np.full(good["qpos"].shape[1], np.inf)
    parts = [part(good, slice(a, a + 40), qpos_std=unknown, qvel_std=unknown) for a in (0, 80)]
    check_apart(NAMES, parts)


def test_ten_shared_rows_are_refused_and_nine_are_not(good):
    first = part(good, slice(0, 60))
    check_apart(NAMES, [first, part(good, slice(51, 76))])
    with pytest.raises(InvalidInput, match="give each row of a recording once"):
        check_apart(NAMES, [first, part(good, slice(50, 76))])


def test_the_same_arrays_in_another_file_are_refused(good, tmp_path):
    whole = Measurement(**good)
    np.savez_compressed(tmp_path / "second.npz", **good)
    again = Measurement.from_npz((tmp_path / "second.npz").read_bytes())
    assert (tmp_path / "second.npz").read_bytes() != write_arrays(good)
    with pytest.raises(
        InvalidInput, match=r"first\.npz from row 0 on and second\.npz from row 0 on"
    ):
        check_apart(NAMES, [whole, again])


def test_one_recording_and_recordings_of_other_motions_are_accepted(good):
    half = len(good["time"]) // 2
    check_apart(NAMES, [part(good, slice(0, half)), part(good, slice(half, None))])
    check_apart(NAMES[:1], [Measurement(**good)])


@pytest.mark.parametrize("speed", [0, 1], ids=["rests", "turns steadily"])
def test_what_a_coarse_sensor_shows_twice_is_no_overlap(speed):
    """The same commands, and positions that are the same to a step of the encoder."""
    rng, n = np.random.default_rng(0), 60
    same = {"time": 0.01 * np.arange(n), "ctrl": rng.normal(size=(n, 1))}
    recordings = [
        Measurement(
            **same,
            qpos=0.01 * speed * np.arange(n)[:, None] + (np.arange(n) == flicker)[:, None] * 0.01,
            qvel=np.zeros((n, 1)),
            qvel_std=np.array([np.inf]),
            episode=np.zeros(n, dtype=np.int64),
        )
        for flicker in (20, 40)
    ]
    check_apart(NAMES, recordings)

import io

import numpy as np
import pytest

from adr_service.errors import InvalidInput
from adr_service.transitions import TransitionDataset


def dataset(episodes=(0, 0, 0, 1, 1), **changes):
    n = len(episodes)
    rng = np.random.default_rng(0)
    fields = {
        "observations": rng.normal(size=(n, 3)),
        "actions": rng.normal(size=(n, 2)),
        "next_observations": rng.normal(size=(n, 3)),
        "episodes": np.array(episodes),
        "dt": 0.02,
        "columns": ("a [m]", "b [m]", "c [m/s]"),
        "origin": "test",
    }
    return TransitionDataset(**{**fields, **changes})


def test_npz_gives_the_same_data_and_the_same_bytes_back():
    data = dataset()
    copy = TransitionDataset.from_npz(data.to_npz())
    np.testing.assert_array_equal(copy.observations, data.observations)
    np.testing.assert_array_equal(copy.episodes, data.episodes)
    assert (copy.dt, copy.columns, copy.origin) == (data.dt, data.columns, data.origin)
    assert copy.to_npz() == data.to_npz()


def test_terminals_mark_the_last_row_of_each_episode():
    with np.load(io.BytesIO(dataset().to_npz())) as arrays:
        assert arrays["terminals"].tolist() == [False, False, True, False, True]


def test_a_file_with_terminals_alone_has_its_episodes():
    with np.load(io.BytesIO(dataset().to_npz())) as arrays:
        fields = {name: arrays[name] for name in arrays.files if name != "episodes"}
    buffer = io.BytesIO()
    np.savez(buffer, **fields)
    assert TransitionDataset.from_npz(buffer.getvalue()).episodes.tolist() == [0, 0, 0, 1, 1]


def test_windows_never_cross_an_episode_and_do_not_overlap():
    assert dataset().windows(1).tolist() == [0, 1, 2, 3, 4]
    assert dataset().windows(2).tolist() == [0, 3]
    assert dataset().windows(4).tolist() == []


def test_concatenated_episodes_stay_apart():
    both = TransitionDataset.concatenate([dataset(), dataset()])
    assert both.episodes.tolist() == [0, 0, 0, 1, 1, 2, 2, 2, 3, 3]
    assert [len(part) for part in both.split()] == [3, 2, 3, 2]


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        dataset().observations[0, 0] = 1.0


def test_a_value_that_is_not_finite_is_refused_with_its_place():
    bad = np.zeros((5, 3))
    bad[3, 1] = np.nan
    with pytest.raises(InvalidInput, match="next_observations is not finite at row 3, column 1"):
        dataset(next_observations=bad)


@pytest.mark.parametrize(
    "changes",
    [
        {"actions": np.zeros((4, 2))},
        {"observations": np.zeros((5, 2))},
        {"episodes": np.array([0, 1, 0, 1, 1])},
        {"columns": ("a [m]",)},
        {"dt": 0.0},
        {"actions": np.zeros(5)},
    ],
    ids=["rows", "width", "order", "columns", "dt", "rank"],
)
def test_data_that_does_not_fit_together_is_refused(changes):
    with pytest.raises(InvalidInput):
        dataset(**changes)


def test_bytes_that_are_no_npz_are_refused():
    with pytest.raises(InvalidInput, match="not a readable"):
        TransitionDataset.from_npz(b"not a zip")


def test_pickled_objects_are_refused():
    buffer = io.BytesIO()
    np.savez(buffer, observations=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InvalidInput, match="not a readable"):
        TransitionDataset.from_npz(buffer.getvalue())


def test_missing_arrays_are_named():
    buffer = io.BytesIO()
    np.savez(buffer, observations=np.zeros((2, 2)))
    with pytest.raises(InvalidInput, match=r"lacks.*actions"):
        TransitionDataset.from_npz(buffer.getvalue())

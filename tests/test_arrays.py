"""Frozen arrays, scales of columns, and the row ranges of episodes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adr_service.arrays import column_scales, frozen, spans

episode_ids = st.lists(st.integers(0, 3), max_size=30).map(lambda ids: np.array(sorted(ids), int))


def test_a_frozen_array_is_a_read_only_copy_in_float64():
    values = np.array([[1, 2], [3, 4]], dtype=np.int32, order="F")
    copy = frozen(values)
    values[0, 0] = 9
    assert copy.dtype == np.float64
    assert copy.flags.c_contiguous
    assert copy.tolist() == [[1, 2], [3, 4]]
    with pytest.raises(ValueError, match="read-only"):
        copy[0, 0] = 9


@pytest.mark.parametrize("value", [0.0, 0.1, 0.3, 0.7])
def test_a_constant_column_has_the_scale_one_whatever_its_value(value):
    varying = np.linspace(0, 1, 41)
    scales = column_scales(np.stack([varying, np.full(41, value)], axis=1))
    assert scales.tolist() == [varying.std(), 1.0]


@given(episode_ids)
def test_the_ranges_of_episodes_cover_every_row_once_and_in_order(ids):
    rows = [row for first, last in spans(ids) for row in range(first, last)]
    assert rows == list(range(len(ids)))


@given(episode_ids)
def test_there_is_one_range_per_episode_and_one_id_per_range(ids):
    ranges = spans(ids)
    assert len(ranges) == len(set(ids.tolist()))
    assert all(len(set(ids[first:last].tolist())) == 1 for first, last in ranges)


def test_an_id_that_comes_back_starts_another_range():
    assert spans(np.array([0, 0, 1, 0])) == [(0, 2), (2, 3), (3, 4)]

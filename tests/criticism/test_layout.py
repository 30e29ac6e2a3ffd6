"""Transitions by episode, of episodes of different lengths."""

import numpy as np
import pytest

from adr_service.criticism.layout import Layout
from adr_service.criticism.measurements import Measurement
from adr_service.criticism.simulator import Simulator
from tests.hidden import arm

ROWS = (10, 2, 7)  # of each episode


@pytest.fixture(scope="module")
def simulator(good):
    """A simulator of three episodes of different lengths."""
    kept = np.concatenate([np.flatnonzero(good["episode"] == e)[:n] for e, n in enumerate(ROWS)])
    data = Measurement(**{name: values[kept] for name, values in good.items()})
    with Simulator(arm()[1], data, threads=1) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def layout(simulator):
    return Layout.of(simulator)


def test_every_transition_has_one_place(layout, simulator):
    assert layout.mask.shape == (len(ROWS), max(ROWS) - 1)
    np.testing.assert_array_equal(layout.mask.sum(axis=1), [rows - 1 for rows in ROWS])
    np.testing.assert_array_equal(layout.index[layout.mask], np.arange(len(simulator.starts)))


@pytest.mark.parametrize("shape", [(), (4,), (4, 3)])
def test_folded_values_come_back_under_the_mask(layout, simulator, shape):
    values = np.random.default_rng(0).standard_normal((len(simulator.starts), *shape))
    folded = layout.fold(values)
    assert folded.shape == (*layout.mask.shape, *shape)
    np.testing.assert_array_equal(folded[layout.mask], values)


def test_padding_is_zero_even_where_the_first_transition_is_nan(layout, simulator):
    """Padding points at transition 0, whose value must not leak."""
    values = np.ones((len(simulator.starts), 2))
    values[0] = np.nan
    assert not layout.fold(values)[~layout.mask].any()


def test_folding_leaves_its_argument_as_it_is(layout, simulator):
    values = np.arange(len(simulator.starts), dtype=float)
    layout.fold(values)
    np.testing.assert_array_equal(values, np.arange(len(simulator.starts)))


def test_states_by_row_are_the_inverse_of_states_by_episode(layout, simulator):
    """Each episode has one state more than it has transitions."""
    states = np.full((len(ROWS), max(ROWS), 4), np.nan)
    for episode, (first, last) in enumerate(simulator.data.spans()):
        states[episode, : last - first] = simulator.measured[first:last]
    rows = layout.by_row(simulator, states)
    np.testing.assert_array_equal(rows, simulator.measured)
    folded = layout.fold(rows[simulator.starts])
    np.testing.assert_array_equal(folded[layout.mask], states[:, :-1][layout.mask])

"""Outcomes by cell."""

import pytest

from adr_service.benchmark.cells import Cell, Measured

SEEDS = (0, 1)


@pytest.fixture(scope="module")
def measured(benchmark):
    """Methods with iterations and without, on two seeds."""
    return Measured(benchmark[2])


def test_a_cell_is_said_in_words():
    assert str(Cell("hopper", "noisy", "dropo")) == "dropo on hopper noisy"
    collected = Cell("hopper", "noisy", "dropo", 2, "random")
    assert str(collected) == "dropo on random data on hopper noisy after 2"


def test_a_cell_means_the_last_iteration_and_has_every_seed(measured):
    cell = Cell("arm", "vanilla", "simopt")
    assert measured.iterations(cell) == [0, 1, 2]
    assert measured.resolve(cell) == 2
    assert tuple(measured.of(cell)) == SEEDS


def test_methods_without_iterations_are_measured_at_zero(measured):
    for method in ("udr", "prior"):
        assert measured.resolve(Cell("arm", "vanilla", method)) == 0


def test_a_cell_that_nobody_ran_is_empty(measured):
    assert measured.of(Cell("hopper", "vanilla", "dropo")) == {}
    assert measured.iterations(Cell("hopper", "vanilla", "dropo")) == []

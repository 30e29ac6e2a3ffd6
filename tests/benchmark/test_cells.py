"""Outcomes by cell."""

import pytest

from adr_service.benchmark.cells import Cell, Measured
from adr_service.benchmark.comparison import Outcome
from adr_service.stages.local import LocalStages
from tests.programs.smoke import iterations, smoke

SEEDS = (0, 1)


@pytest.fixture(scope="module")
def measured():
    """A method with iterations and two without, on two seeds."""
    stages = LocalStages()
    specs = [smoke(method, seed=seed) for method in ("simopt", "udr", "prior") for seed in SEEDS]
    return Measured([Outcome(s, event) for s in specs for event in iterations(s, stages)])


def test_a_cell_is_said_in_words():
    assert str(Cell("hopper", "noisy", "dropo")) == "dropo on hopper noisy"
    collected = Cell("hopper", "noisy", "dropo", 2, "random")
    assert str(collected) == "dropo on random data on hopper noisy after 2"


def test_a_cell_means_the_last_iteration_and_has_every_seed(measured):
    cell = Cell("arm", "vanilla", "simopt")
    assert measured.iterations(cell) == [0, 1]
    assert measured.resolve(cell) == 1
    assert tuple(measured.of(cell)) == SEEDS


def test_methods_without_iterations_are_measured_at_zero(measured):
    for method in ("udr", "prior"):
        assert measured.resolve(Cell("arm", "vanilla", method)) == 0


def test_a_cell_that_nobody_ran_is_empty(measured):
    assert measured.of(Cell("hopper", "vanilla", "dropo")) == {}
    assert measured.iterations(Cell("hopper", "vanilla", "dropo")) == []

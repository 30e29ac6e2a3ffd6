"""Outcomes by cell."""

from adr_service.benchmark.cells import Cell, Measured


def test_a_cell_is_said_in_words():
    assert str(Cell("hopper", "noisy", "dropo")) == "dropo on hopper noisy"
    collected = Cell("hopper", "noisy", "dropo", 2, "random")
    assert str(collected) == "dropo on random data on hopper noisy after 2"


def test_every_seed_of_a_benchmark_is_measured(benchmark):
    spec, _, outcomes = benchmark
    measured = Measured(outcomes)
    for method in ("simopt", "dropo"):
        cell = Cell("arm", "noisy", method)
        assert list(measured.of(cell)) == spec.seeds
        assert measured.iterations(cell) == [0, 1, 2]
        assert measured.resolve(cell) == 2  # the last of the paper's preset is the last measured


def test_methods_without_iterations_are_measured_at_zero(benchmark):
    measured = Measured(benchmark[2])
    for method in ("udr", "prior", "oracle"):
        assert measured.resolve(Cell("arm", "noisy", method)) == 0


def test_a_cell_that_nobody_ran_is_empty(benchmark):
    measured = Measured(benchmark[2])
    assert measured.of(Cell("hopper", "vanilla", "dropo")) == {}
    assert measured.iterations(Cell("hopper", "vanilla", "dropo")) == []

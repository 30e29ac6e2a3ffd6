"""The logic of verdicts: what one check says, and several together."""

import itertools

import pytest

from adr_service.benchmark.cells import Cell, Measured
from adr_service.benchmark.checks import all_of, beyond, conjunction, higher, none_of
from adr_service.benchmark.statistics import Interval

VERDICTS = ("supported", "contradicted", "undecided", "not measured")
NOTHING = Measured([])


def saying(verdict):
    """A check that always gives this verdict."""
    return lambda measured: (verdict, [verdict])


@pytest.mark.parametrize("verdict", VERDICTS)
def test_one_check_alone_decides(verdict):
    assert all_of([saying(verdict)])(NOTHING) == (verdict, [verdict])


@pytest.mark.parametrize(("one", "other"), list(itertools.product(VERDICTS, repeat=2)))
def test_the_order_of_checks_does_not_matter(one, other):
    assert conjunction([(one, []), (other, [])]) == conjunction([(other, []), (one, [])])


@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_contradiction_outweighs_everything(verdict):
    assert all_of([saying(verdict), saying("contradicted")])(NOTHING)[0] == "contradicted"


def test_none_of_is_the_opposite_of_any():
    assert none_of([saying("contradicted"), saying("contradicted")])(NOTHING)[0] == "supported"
    assert none_of([saying("contradicted"), saying("supported")])(NOTHING)[0] == "contradicted"
    assert none_of([saying("contradicted"), saying("undecided")])(NOTHING)[0] == "undecided"


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(0.2, 0.3, "supported"), (-0.3, -0.1, "contradicted"), (-0.1, 0.1, "undecided")],
)
def test_an_interval_decides_by_the_side_of_the_bound(low, high, verdict):
    assert beyond(Interval((low + high) / 2, low, high), 0.0) == verdict


def test_a_method_is_not_compared_with_itself_or_with_one_that_did_not_run():
    cell = Cell("hopper", "vanilla", "dropo")
    assert higher(cell, cell)(NOTHING) == ("not measured", [])
    assert higher(cell, Cell("hopper", "vanilla", "udr"))(NOTHING) == ("not measured", [])

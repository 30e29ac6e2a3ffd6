"""The logic of checks: what one says, and several together."""

import itertools

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from adr_service.benchmark.cells import Cell, Measured
from adr_service.benchmark.checks import (
    Evidence,
    above,
    all_of,
    conjunction,
    drops,
    equal,
    higher,
    none_of,
)
from tests.benchmark.test_claims import outcome

NOTHING = Measured([])
SURE, UNSURE = 1e-6, 0.4
FOR = Evidence(SURE, 1 - SURE, ["for"])
AGAINST = Evidence(1 - SURE, SURE, ["against"])
OPEN = Evidence(UNSURE, 1 - UNSURE, ["open"])
MISSING = Evidence(1.0, 1.0, ["missing"], "not measured")
ALL = (FOR, AGAINST, OPEN, MISSING)


def saying(evidence):
    """A check that always gives this evidence."""
    return lambda measured: evidence


def numbers(evidence):
    return evidence.supports, evidence.contradicts, evidence.gap


@pytest.mark.parametrize("evidence", ALL)
def test_one_check_alone_decides(evidence):
    assert numbers(all_of([saying(evidence)])(NOTHING)) == numbers(evidence)


@pytest.mark.parametrize(("one", "other"), list(itertools.product(ALL, repeat=2)))
def test_the_order_of_checks_does_not_matter(one, other):
    assert numbers(conjunction([one, other])) == numbers(conjunction([other, one]))


@pytest.mark.parametrize("evidence", ALL)
def test_a_contradiction_outweighs_everything_and_is_corrected_for_their_number(evidence):
    both = all_of([saying(evidence), saying(AGAINST)])(NOTHING)
    assert both.contradicts <= 2 * SURE
    assert both.supports > 0.5


def test_a_conjunction_is_as_sure_as_its_weakest_part():
    assert numbers(conjunction([FOR, FOR])) == (SURE, 1.0, None)
    assert conjunction([FOR, OPEN]).supports == UNSURE
    assert numbers(conjunction([FOR, MISSING])) == (1.0, 1 - SURE, "measured in part")


def test_none_of_is_the_opposite_of_any():
    assert none_of([saying(AGAINST), saying(AGAINST)])(NOTHING).supports == SURE
    assert none_of([saying(AGAINST), saying(FOR)])(NOTHING).contradicts == 2 * SURE
    assert none_of([saying(AGAINST), saying(OPEN)])(NOTHING).supports == 1 - UNSURE


def test_p_values_are_those_of_students_test():
    values = np.array([1.0, 1.2, 0.7, 1.1])
    evidence = above(values, 0.9, "")
    for p, side in ((evidence.supports, "greater"), (evidence.contradicts, "less")):
        assert p == pytest.approx(ttest_1samp(values, 0.9, alternative=side).pvalue)


def test_the_seeds_needed_are_those_at_which_the_test_settles_it():
    values = np.array([1.0, 1.2, 0.7, 1.1])
    needed = int(above(values, 0.9, "").needed(0.05))
    # as many values with the same mean and standard deviation
    for count, settles in ((needed - 1, False), (needed, True)):
        spread = np.resize([-1.0, 1.0], count - count % 2)
        spread = np.append(spread, np.zeros(count % 2))
        values_then = values.mean() + spread * values.std(ddof=1) / spread.std(ddof=1)
        assert (2 * above(values_then, 0.9, "").supports < 0.05) == settles


def test_an_equality_that_fails_by_little_is_what_more_seeds_would_settle():
    """The correction for its two sides hides from p-values alone on which side of .5 it is."""

    def equal(mean, count):
        spread = np.linspace(-1, 1, count)
        values = mean + 0.05 * spread / spread.std(ddof=1)
        return conjunction([above(values, -0.1, ""), above(-values, -0.1, "")])

    def both(count):
        return conjunction([equal(0.0, count), equal(0.11, count)])

    needed = int(both(3).needed(0.05))
    assert 2 * both(needed).contradicts < 0.05
    assert 2 * both(needed - 10).contradicts > 0.05


def test_one_seed_settles_nothing_and_leans_to_its_side():
    up, down = above(np.array([2.0]), 0.0, ""), above(np.array([-2.0]), 0.0, "")
    assert min(up.supports, up.contradicts, down.supports, down.contradicts) == 0.5
    assert (up.leans_to_support, down.leans_to_support) == (True, False)


def test_equal_seeds_are_taken_to_spread_as_trainings_do():
    """Methods that share a policy, or a gait, have no spread: two such seeds prove nothing."""
    two, five = (above(np.zeros(count), -0.1, "").supports for count in (2, 5))
    assert two > 0.01
    assert five < 0.001
    at_the_bound = above(np.full(3, 1.0), 1.0, "")
    assert (at_the_bound.supports, at_the_bound.contradicts) == (0.5, 0.5)


def test_a_nested_contradiction_counts_in_the_correction():
    inner = Evidence(1.0, 0.03, [], "not measured", in_part=True)
    assert conjunction([inner, inner]).contradicts == 0.06


def worse_with_more_data(seeds):
    """Outcomes of DROID, which earns less after its second iteration, and of the oracle."""
    levels = {("droid", 1): 1.3, ("droid", 2): 1.0, ("oracle", 0): 1.0}
    return [
        outcome(level, task="walker2d", method=method, iteration=iteration, seed=seed)
        for (method, iteration), level in levels.items()
        for seed in seeds
    ]


def test_a_seed_that_has_just_begun_leaves_the_others_judged():
    begun = outcome(1.0, task="walker2d", method="droid", iteration=0, seed=9)
    check = drops("walker2d", "vanilla", "droid")
    found = worse_with_more_data(range(8))
    with_begun = check(Measured([*found, begun]))
    assert with_begun.supports == check(Measured(found)).supports < 0.001


def test_cells_without_a_common_seed_are_named_as_not_measured():
    cells = [Cell("walker2d", "vanilla", "droid", number) for number in (1, 2)]
    apart = [
        o
        for o in worse_with_more_data(range(6))
        if o.spec.method.name == "oracle" or o.iteration.iteration == 1 + o.spec.seed // 3
    ]
    (line,) = higher(*cells)(Measured(apart)).lines
    assert line.endswith("have no seed in common")
    (line,) = drops("walker2d", "vanilla", "droid")(Measured(apart[:3] + apart[6:])).lines
    assert line == "droid on walker2d vanilla has fewer than two iterations of the same seeds"


def test_a_method_is_not_compared_with_itself_or_with_one_that_did_not_run():
    cell = Cell("hopper", "vanilla", "dropo")
    assert higher(cell, cell)(NOTHING).gap == "not measured"
    assert higher(cell, Cell("hopper", "vanilla", "udr"))(NOTHING).gap == "not measured"


@pytest.mark.parametrize(("gap", "is_equal"), [(0.06, True), (0.14, False)])
def test_methods_are_equal_that_differ_by_less_than_a_tenth(gap, is_equal):
    found = [
        outcome(level, method=method, iteration=iteration, seed=seed)
        for method, level, iteration in (("dropo", 1 + gap, 2), ("simopt", 1, 2), ("oracle", 1, 0))
        for seed in range(9)
    ]
    cells = [Cell("hopper", "vanilla", method) for method in ("dropo", "simopt")]
    evidence = equal(*cells)(Measured(found))
    assert (evidence.supports < 0.05, evidence.contradicts < 0.05) == (is_equal, not is_equal)

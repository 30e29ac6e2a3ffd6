"""Methods over all tasks and variants."""

import numpy as np
import pytest
from scipy.stats import t as student

from adr_service.benchmark.aggregate import aggregates, profiles
from adr_service.benchmark.comparison import not_compared
from tests.benchmark.test_claims import outcome


def world(levels):
    """Outcomes of (method, variant) -> normalised returns by seed."""
    return [
        outcome(level, method=method, variant=variant, seed=seed, spread=0.0)
        for (method, variant), values in levels.items()
        for seed, level in enumerate(values)
    ]


TWO = {
    ("simopt", "vanilla"): (1.0,) * 3,
    ("simopt", "noisy"): (0.5,) * 3,
    ("dropo", "vanilla"): (0.8,) * 3,
    ("dropo", "noisy"): (0.8,) * 3,
}


def test_the_aggregate_is_over_all_cells_policies():
    simopt, dropo = aggregates(world(TWO))
    assert (simopt.method, simopt.cells, simopt.seeds, simopt.policies) == ("simopt", 2, 3, 6)
    # of three times 0.5 and three times 1.0, the middle
    assert simopt.interquartile_mean == pytest.approx(0.75)
    assert dropo.interquartile_mean == pytest.approx(0.8)
    # each cell is resampled by itself, and its seeds are equal
    bootstrap = (simopt.interquartile_low, simopt.interquartile_high)
    assert bootstrap == pytest.approx((0.75, 0.75))


def test_a_policy_that_fails_counts_in_full_in_the_mean():
    failing = {**TWO, ("simopt", "noisy"): (0.5, 0.5, 0.0)}
    simopt, _ = aggregates(world(failing))
    assert simopt.mean == pytest.approx((0.75 + 0.75 + 0.5) / 3)
    reach = student.isf(0.025, 2) * np.std([0.75, 0.75, 0.5], ddof=1) / np.sqrt(3)
    assert (simopt.low, simopt.high) == pytest.approx((simopt.mean - reach, simopt.mean + reach))


def test_seeds_that_differ_between_cells_have_a_mean_without_an_interval():
    three = world(TWO)
    four = outcome(1.0, method="simopt", variant="vanilla", seed=3, spread=0.0)
    simopt = next(each for each in aggregates([*three, four]) if each.method == "simopt")
    assert (simopt.mean, simopt.low) == (pytest.approx(0.75), None)


def test_policies_that_are_evaluated_on_two_variants_count_once():
    """And their seeds are not taken for six."""

    def oracle(trained_on):
        return [
            outcome(level, method="oracle", variant=variant, seed=seed, trained_on=trained_on)
            for variant in ("vanilla", "noisy")
            for seed, level in enumerate((0.5, 0.8, 1.0))
        ]

    (shared,), (apart,) = aggregates(oracle("vanilla")), aggregates(oracle(None))
    assert (shared.cells, shared.seeds, shared.policies, apart.policies) == (2, 3, 3, 6)
    assert shared.interquartile_mean == apart.interquartile_mean
    widths = [each.interquartile_high - each.interquartile_low for each in (shared, apart)]
    assert widths[0] > 1.2 * widths[1]


def test_only_cells_that_all_methods_have_count():
    more = {**TWO, ("simopt", "unmodeled"): (9.0,) * 3}
    assert aggregates(world(more)) == aggregates(world(TWO))
    apart = {("simopt", "vanilla"): (1.0,), ("dropo", "noisy"): (1.0,)}
    assert aggregates(world(apart)) == profiles(world(apart)) == []


def test_a_method_that_has_begun_in_one_cell_does_not_leave_out_the_other_cells():
    begun = {**TWO, ("udr", "vanilla"): (0.9,) * 3}
    assert aggregates(world(begun)) == aggregates(world(TWO))
    every = {**begun, ("udr", "noisy"): (0.9,) * 3}
    assert [each.method for each in aggregates(world(every))] == ["udr", "simopt", "dropo"]


def test_methods_are_taken_after_the_iteration_at_which_they_are_compared():
    """Also where another collector's data decide which one that is."""
    finished = [
        outcome(1.0, method=method, seed=seed, iteration=number, **given)
        for method, given in (("simopt", {}), ("dropo", {"collector": "random"}))
        for seed in range(3)
        for number in (1, 2)
    ]
    begun = [outcome(0.5, method="dropo", seed=seed, iteration=1) for seed in range(3)]
    found = [*finished, *begun]
    assert not_compared(found) == ["dropo (hopper vanilla)"]
    assert [each.method for each in aggregates(found)] == ["simopt"]


def test_a_method_that_has_only_the_priors_policy_is_not_ranked():
    """As in a benchmark that was cancelled after its first trainings."""
    curriculum = [outcome(0.8, method="udr", seed=seed, iteration=0) for seed in range(3)]
    begun = [
        outcome(0.9, method=method, seed=seed, iteration=0)
        for method in ("simopt", "dropo")
        for seed in range(3)
    ]
    assert [each.method for each in aggregates([*begun, *curriculum])] == ["udr"]


def test_a_cell_of_two_seeds_has_no_interval():
    few = {key: values[:2] for key, values in TWO.items()}
    assert {(each.low, each.high) for each in aggregates(world(few))} == {(None, None)}


def test_a_profile_falls_from_all_policies_to_none():
    points = [point for point in profiles(world(TWO)) if point.method == "simopt"]
    shares = np.array([point.share for point in points])
    levels = np.array([point.level for point in points])
    assert np.all(np.diff(shares) <= 0)
    assert set(shares[levels < 0.49]) == {1.0}
    assert set(shares[(levels > 0.51) & (levels < 0.99)]) == {0.5}
    assert set(shares[levels > 1.01]) == {0.0}

"""Result tables of a small benchmark of all methods."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from adr_service.benchmark.comparison import (
    comparisons,
    costs,
    decode,
    estimates,
    final_outcomes,
    last_shared,
    lost,
    not_compared,
    table,
    to_csv,
)
from adr_service.distributions import Gaussian
from adr_service.methods.catalogue import methods
from adr_service.specs.lost import Lost
from adr_service.tasks.catalogue import source_of
from tests.benchmark.conftest import ITERATIONS, METHODS, with_a_third_seed
from tests.benchmark.test_claims import outcome as at_level


def test_the_table_has_every_method_with_its_interval_and_counts(benchmark):
    rows = table(benchmark[2])
    assert [row.method for row in rows if row.variant == "noisy"] == [
        "udr",
        *["bayrn"] * (ITERATIONS + 1),
        *["simopt"] * (ITERATIONS + 1),
        *["simopt_1"] * (ITERATIONS + 1),
        *["droid"] * 3 * (ITERATIONS + 1),
        *["dropo"] * 3 * (ITERATIONS + 1),
        *["sysid"] * 3 * (ITERATIONS + 1),
        "prior",
        "oracle",
    ]
    for row in rows:
        assert (row.low, row.interquartile_low) == (None, None)  # of two seeds
        assert (row.seeds, row.episodes) == (2, 4 * row.policies)
    for row in table(with_a_third_seed(benchmark[2])):
        assert row.low <= row.normalised_return <= row.high
    simopt = [row for row in rows if (row.method, row.variant) == ("simopt", "vanilla")]
    assert [row.target_transitions for row in simopt] == [0, 20, 40]
    assert simopt[0].posterior_std == 1
    assert simopt[-1].posterior_std < 1
    assert all(row.posterior_std == 0 for row in rows if row.method == "sysid" and row.iteration)


def test_a_row_tells_what_was_read_and_simulated(benchmark):
    _, _, outcomes = benchmark
    for row in table(outcomes):
        assert (row.target_returns > 0) == (row.method == "bayrn")
        if row.method == "bayrn":
            assert row.target_returns == row.target_rollouts
        inferred = row.iteration > 0 and methods()[row.method]().infers
        assert (row.inference_steps > 0) == inferred


def test_every_pair_of_methods_is_compared_after_the_last_iteration(benchmark):
    found = comparisons(benchmark[2])
    assert all((pair.low, pair.difference_low, pair.seeds) == (None, None, 2) for pair in found)
    for pair in comparisons(with_a_third_seed(benchmark[2])):
        assert pair.difference_low <= pair.difference <= pair.difference_high
        assert (pair.low, pair.seeds) == (None, 3)
    names = {run.column for run in benchmark[0].runs()}
    assert len(names) == 6 + 3 * 3
    assert len(found) == 2 * len(names) * (len(names) - 1) // 2


def test_the_first_of_a_pair_is_the_better_one_where_it_earns_more():
    found = [
        at_level(level, method=method, seed=seed)
        for method, level in (("simopt", 1.0), ("dropo", 0.5))
        for seed in range(5)
    ]
    (pair,) = comparisons(found)
    assert pair.low == pair.probability == pair.high
    better = pair.method == "simopt"
    assert {pair.method, pair.other} == {"simopt", "dropo"}
    assert pair.probability == (1.0 if better else 0.0)
    assert pair.difference == pytest.approx(0.5 if better else -0.5, abs=0.02)


@pytest.mark.parametrize(
    ("simopt", "dropo", "after"),
    [
        ({0: 3, 1: 3, 2: 3}, {0: 3, 1: 3, 2: 3}, (2, 2)),
        ({0: 3, 1: 3, 2: 1}, {0: 3, 1: 3, 2: 3}, (1, 1)),  # some seeds are not there yet
        ({0: 3, 1: 3, 2: 3}, {0: 3, 1: 3}, (1, 1)),
        ({0: 3, 1: 2}, {0: 3, 1: 3, 2: 3}, (0, 0)),  # nothing to compare yet, but the prior
        ({5: 3}, {0: 3, 1: 3}, (None, 1)),
    ],
)
@pytest.mark.parametrize("planned", [2, 9])
def test_methods_are_compared_after_the_last_iteration_that_all_seeds_have(
    simopt, dropo, after, planned
):
    seeds = {"simopt": simopt, "dropo": dropo, "oracle": {0: 2}}
    expected = {"simopt": after[0], "dropo": after[1], "oracle": 0}
    compared = {name: number for name, number in expected.items() if number is not None}
    assert last_shared(seeds, {"oracle"}, planned) == compared


@pytest.mark.parametrize("bayrn", [{}, {0: 3}, {0: 3, 1: 3, 2: 2}])
def test_what_still_learns_does_not_hold_back_what_has_finished(bayrn):
    done = {0: 3, 1: 3, 2: 3}
    seeds = {"simopt": done, "dropo": done, "oracle": {0: 2}} | ({"bayrn": bayrn} if bayrn else {})
    assert last_shared(seeds, {"oracle"}, 2) == {"simopt": 2, "dropo": 2, "oracle": 0}


@pytest.mark.parametrize("new", [{0: 5}, {0: 5, 1: 4, 2: 3}])
def test_seeds_that_still_learn_do_not_hold_back_those_that_have_finished(new):
    extended = {1: 3, 2: 3} | new
    seeds = {"simopt": extended, "dropo": extended, "oracle": {0: 5}}
    assert last_shared(seeds, {"oracle"}, 2) == {"simopt": 2, "dropo": 2, "oracle": 0}
    alone = {"simopt": extended, "oracle": {0: 5}}
    assert last_shared(alone, {"oracle"}, 2) == {"simopt": 2, "oracle": 0}
    failed = {0: 3, 1: 3, 2: 2}  # and are too few for an interval
    assert "bayrn" not in last_shared({**seeds, "bayrn": failed}, {"oracle"}, 2)


def test_a_benchmark_that_is_not_finished_compares_equal_amounts_of_data(benchmark):
    outcomes = [
        outcome
        for outcome in benchmark[2]
        if outcome.iteration.iteration < ITERATIONS
        or (outcome.spec.column, outcome.spec.seed) == ("simopt", 0)
    ]
    for columns in final_outcomes(outcomes).values():
        for name, found in columns.items():
            learns = methods()[name.split()[0]].learns_from != "nothing"
            expected = ITERATIONS - 1 if learns else 0
            assert {outcome.iteration.iteration for outcome in found} == {expected}, name
            assert len(found) == 2


def test_a_method_that_still_learns_is_not_compared_with_those_that_have_finished(benchmark):
    outcomes = [
        outcome
        for outcome in benchmark[2]
        if outcome.iteration.iteration < ITERATIONS
        or (outcome.spec.column, outcome.spec.seed) != ("bayrn", 1)
    ]
    whole, partial = final_outcomes(benchmark[2]), final_outcomes(outcomes)
    assert list(partial) == list(whole)
    assert not_compared(benchmark[2]) == []
    for place, columns in partial.items():
        assert set(whole[place]) - set(columns) == {"bayrn"}
        assert f"bayrn ({' '.join(place)})" in not_compared(outcomes)
        assert all(found == whole[place][name] for name, found in columns.items())


def test_where_all_runs_that_learn_have_failed_they_are_compared_as_far_as_they_came(benchmark):
    outcomes = [
        replace(outcome, has_failed=methods()[outcome.spec.method.name].learns_from != "nothing")
        for outcome in benchmark[2]
        if outcome.iteration.iteration < ITERATIONS
    ]
    for columns in final_outcomes(outcomes).values():
        reached = {found[0].iteration.iteration for found in columns.values()}
        assert reached == {0, ITERATIONS - 1}


@pytest.mark.parametrize("failing", [("bayrn", (0, 1)), ("simopt", (1,))])
def test_runs_that_failed_hold_nobody_back(benchmark, failing):
    """All methods were compared by the prior's policies then, until somebody resumed the run."""
    method, seeds = failing
    failed = [o.spec.column == method and o.spec.seed in seeds for o in benchmark[2]]
    outcomes = [
        replace(outcome, has_failed=has_failed)
        for outcome, has_failed in zip(benchmark[2], failed, strict=True)
        if not has_failed or outcome.iteration.iteration == 0
    ]
    for place, columns in final_outcomes(outcomes).items():
        whole = final_outcomes(benchmark[2])[place]
        for name, found in columns.items():
            gone = seeds if name == method else ()
            assert found == [o for o in whole[name] if o.spec.seed not in gone]
        assert (method in columns) == (len(seeds) == 1)
    assert {pair.iteration for pair in comparisons(outcomes)} == {0, ITERATIONS}


def test_the_prior_is_iteration_zero_of_every_method(benchmark):
    rows = table(benchmark[2])
    prior = {row.variant: row for row in rows if row.method == "prior"}
    for row in rows:
        if row.method in {"simopt", "dropo"} and row.iteration == 0:
            assert row.normalised_return == prior[row.variant].normalised_return


def test_outcomes_in_any_order_give_the_same_csv(benchmark):
    outcomes = benchmark[2]
    assert to_csv(table(outcomes)) == to_csv(table(outcomes[::-1]))


def test_estimates_name_every_parameter_with_its_truth(benchmark):
    found = estimates(benchmark[2])
    assert {(e.parameter, e.truth) for e in found} == {
        ("upper_mass", 1.0),
        ("fore_mass", 0.7),
        ("shoulder_friction", 2.0),
        ("elbow_friction", 1.0),
    }


def test_distributions_of_another_version_are_left_out_and_returns_stay(benchmark):
    changed = [replace(o, lost="of old 0.1") if _is_simopt(o) else o for o in benchmark[2]]
    assert lost(changed) == ["arm: of old 0.1"]
    assert lost(benchmark[2]) == []
    assert estimates(changed) == [e for e in estimates(benchmark[2]) if e.method != "simopt"]
    for row, whole in zip(table(changed), table(benchmark[2]), strict=True):
        without = replace(
            whole, estimation_error=None, posterior_std=None, log_score=None, energy_score=None
        )
        assert row == (without if row.method == "simopt" else whole)
    with pytest.raises(Lost, match=r"of old 0\.1"):
        decode(next(o for o in changed if o.lost))


def _is_simopt(outcome):
    return outcome.spec.method.name == "simopt"


def test_inferences_have_their_cost(benchmark):
    _, stages, outcomes = benchmark
    executed = {stage.digest: stage for stage in stages.executed}
    for outcome in outcomes:
        event = outcome.iteration
        kinds = {executed[d].kind for d in event.inferences}
        assert kinds <= ({"propose"} if outcome.spec.method.name == "bayrn" else {"infer"})
    timed = [replace(o, inference_seconds=2.0 * o.spec.seed) for o in outcomes]
    found = costs(timed)
    assert {cost.method for cost in found} == {*METHODS} - {"udr"}
    assert {cost.inference_seconds for cost in found} == {1.0}  # of two seeds
    dropo = [c for c in found if (c.method, c.variant) == ("dropo", "vanilla")]
    assert all(cost.inference_steps > 0 for cost in dropo)


def test_the_width_of_a_belief_is_the_root_of_its_mean_variance():
    space = source_of("hopper", "vanilla").space
    variances = np.linspace(0.1, 2.0, len(space))
    belief = Gaussian(space, np.full(len(space), 2.0), np.diag(variances))
    run = at_level(1.0)
    event = run.iteration.model_copy(update={"distributions": [belief.to_json()]})
    (row,) = table([replace(run, iteration=event)])
    assert row.posterior_std == pytest.approx(np.sqrt(variances.mean()))
    found = estimates([replace(run, iteration=event)])
    assert [each.mean for each in found] == pytest.approx(belief.mean)
    assert [each.std for each in found] == pytest.approx(belief.std)


def test_a_belief_that_excludes_the_truth_has_no_score():
    """Minus infinity is no number of JSON."""
    space = source_of("hopper", "vanilla").space
    wrong = Gaussian(space, np.full(len(space), 2.0), np.diag([0.0] + [0.1] * (len(space) - 1)))
    run = at_level(1.0)
    event = run.iteration.model_copy(update={"distributions": [wrong.to_json()]})
    (row,) = table([replace(run, iteration=event)])
    assert row.log_score is None


def test_a_row_has_students_interval_over_its_seeds_and_the_share_that_reached_the_threshold():
    earned = np.array([0.2, 0.4, 0.9])
    runs = [at_level(level, seed=seed, spread=0.0) for seed, level in enumerate(earned)]
    missed = runs[0].iteration.model_copy(update={"reached_threshold": [False]})
    (row,) = table([replace(runs[0], iteration=missed), *runs[1:]])
    reach = student.isf(0.025, 2) * earned.std(ddof=1) / np.sqrt(3)
    expected = (earned.mean(), earned.mean() - reach, earned.mean() + reach)
    assert (row.normalised_return, row.low, row.high) == pytest.approx(expected)
    assert row.reached_threshold == pytest.approx(2 / 3)


def test_a_robots_run_has_no_distance_from_a_truth():
    (row,) = table([at_level(1.0, target={"kind": "external"})])
    assert (row.estimation_error, row.log_score, row.energy_score) == (None, None, None)
    assert row.posterior_std is not None


def test_methods_that_reported_the_same_policies_are_equal_for_certain():
    ours = [at_level(1.0, method="simopt", seed=seed) for seed in range(5)]
    same = [replace(o, spec=at_level(1.0, method="dropo", seed=o.spec.seed).spec) for o in ours]
    (pair,) = comparisons([*ours, *same])
    assert (pair.low, pair.probability, pair.high) == (0.5, 0.5, 0.5)

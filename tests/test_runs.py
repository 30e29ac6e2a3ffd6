"""Whole runs in this process, on the smoke preset."""

import csv
import io
import itertools
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from adr_service.benchmark.comparison import Outcome, comparisons, costs, estimates, table, to_csv
from adr_service.benchmark.figures import FIGURES, draw, drawable
from adr_service.benchmark.protocol import plan
from adr_service.computation import LocalStages, compute
from adr_service.errors import BudgetExceeded, InvalidInput, UnknownName
from adr_service.events import IterationFinished
from adr_service.runs import run
from adr_service.specs import BenchmarkSpec, RunSpec
from adr_service.target import Target
from adr_service.tasks.catalogue import get_task, source_of
from adr_service.transitions import TransitionDataset

ITERATIONS = 3  # the paper has 5
METHODS = ["udr", "bayrn", "simopt", "simopt_1", "droid", "dropo", "sysid"]


def smoke(method, **changes):
    return RunSpec.model_validate({"task": "arm", "method": method, "preset": "smoke", **changes})


def iterations(spec, stages):
    return [event for event in run(spec, stages) if isinstance(event, IterationFinished)]


@pytest.fixture(scope="module")
def benchmark():
    """(spec, stages, outcomes) of the whole protocol, with references, and of the data study."""
    spec = BenchmarkSpec.model_validate(
        {
            "tasks": ["arm"],
            "variants": ["vanilla", "noisy"],
            "methods": METHODS,
            "collectors": ["simopt", "prior", "random"],
            "seeds": [0, 1],
            "preset": "smoke",
            "iterations": ITERATIONS,
            "training": {"max_steps": 200, "evaluate_every": 200, "learning_starts": 50},
        }
    )
    stages = LocalStages()
    outcomes = [Outcome(r, event) for r in spec.runs() for event in iterations(r, stages)]
    return spec, stages, outcomes


def test_the_prior_policy_of_a_seed_is_trained_once_for_all_methods(benchmark):
    spec, stages, _ = benchmark
    trainings = [s for s in stages.executed if s.kind == "train_policy"]
    digests = [s.digest for s in trainings]
    assert len(set(digests)) == len(digests)
    priors = [
        s
        for s in trainings
        if s.inputs["distribution"]["kind"] == "gaussian"
        and set(s.inputs["distribution"]["location"]) == {2.0}
    ]
    assert len(priors) == len(spec.seeds) * len(spec.variants)


def test_the_plan_counts_the_trainings_that_happen(benchmark):
    spec, stages, _ = benchmark
    planned = plan(list(spec.runs()), cores=2)
    assert plan(list(spec.runs()), cores=0).hours is None
    executed = [s for s in stages.executed if s.kind == "train_policy"]
    rollouts = [s for s in stages.executed if s.kind == "target_rollout"]
    assert planned.trainings == len(executed)
    episodes = [s for s in stages.executed if s.kind == "target_return"]
    most = sum(s.inputs["transitions"] for s in rollouts) + len(episodes) * get_task("arm").horizon
    assert planned.target_transitions == most
    assert planned.environment_steps >= sum(s.inputs["training"]["max_steps"] for s in executed)
    assert planned.hours == pytest.approx(planned.core_hours / 2)


def test_offline_methods_read_what_simopt_or_the_prior_or_chance_collected(benchmark):
    """They add no rollout of their own: SimOpt's are there, and the prior's are SimOpt-1's."""
    spec, stages, _ = benchmark
    rollouts = [s for s in stages.executed if s.kind == "target_rollout"]
    runs = len(spec.seeds) * len(spec.variants)
    random = [s for s in rollouts if not s.blobs]
    assert len(random) == ITERATIONS * runs
    assert len(rollouts) - len(random) == (2 * ITERATIONS - 1) * runs  # the first is common to both


def test_random_actions_are_uniform_within_their_bounds():
    stages = LocalStages()
    iterations(smoke("droid", collector="random", transitions=200, iterations=1), stages)
    rollout = next(s for s in stages.executed if s.kind == "target_rollout")
    actions = TransitionDataset.from_npz(compute(rollout).blobs["data"]).actions
    assert len(actions) == 200
    assert np.abs(actions).max() <= 1
    np.testing.assert_allclose(actions.var(axis=0), 1 / 3, rtol=0.2)
    assert len(np.unique(actions)) == actions.size


def test_a_collector_is_for_offline_methods():
    with pytest.raises(ValidationError, match="droid, dropo, sysid"):
        smoke("simopt", collector="random")
    spec = {"tasks": ["arm"], "methods": ["udr", "dropo"], "collectors": ["prior", "random"]}
    columns = [run.column for run in BenchmarkSpec.model_validate({**spec, "seeds": [0]}).runs()]
    assert columns == ["udr", "dropo on prior", "dropo on random", "prior", "oracle"]


def test_a_run_repeats_to_the_last_digit():
    first, second = (list(run(smoke("dropo"), LocalStages())) for _ in range(2))
    assert first == second


def test_running_again_over_finished_stages_computes_nothing_and_says_the_same():
    stages = LocalStages()
    first = list(run(smoke("simopt"), stages))
    count = len(stages.executed)
    assert list(run(smoke("simopt"), stages)) == first
    assert len(stages.executed) == count


def test_a_run_interrupted_anywhere_ends_the_same():
    whole = list(run(smoke("simopt"), LocalStages()))
    for cut in range(1, len(whole)):
        stages = LocalStages()
        began = list(itertools.islice(run(smoke("simopt"), stages), cut))
        assert began == whole[:cut]
        assert list(run(smoke("simopt"), stages)) == whole


def test_seeds_differ():
    zero, one = (iterations(smoke("prior", seed=seed), LocalStages()) for seed in (0, 1))
    assert zero[0].returns != one[0].returns


@pytest.mark.parametrize("variant", ["noisy", "unmodeled"])
@pytest.mark.parametrize("method", ["simopt", "dropo", "oracle"])
def test_every_variant_runs(variant, method):
    found = iterations(smoke(method, variant=variant), LocalStages())
    assert found[-1].target_rollouts == (0 if method == "oracle" else 1)


def test_the_target_counts_and_refuses_what_is_over_the_budget():
    spec, stages = smoke("simopt"), LocalStages()
    policies = list(_policies(stages))
    target = Target(spec, stages)
    _drain(target.rollout(policies[0], 0))
    assert (target.rollouts, target.transitions) == (1, 20)
    with pytest.raises(BudgetExceeded, match="1 used and 1 more asked for, but the budget is 1"):
        _drain(target.rollout(policies[0], 1))
    assert len([s for s in stages.executed if s.kind == "target_rollout"]) == 1


def test_transitions_are_metered_over_iterations():
    stages = LocalStages()
    for method in ("simopt", "dropo"):
        found = iterations(smoke(method, iterations=2), stages)
        assert [event.target_transitions for event in found] == [0, 20, 40]
        assert [event.iteration for event in found] == [0, 1, 2]
    rollouts = [s for s in stages.executed if s.kind == "target_rollout"]
    assert len(rollouts) == 2  # DROPO read SimOpt's


def test_of_several_epsilons_the_one_that_predicts_best_is_taken():
    stages = LocalStages()
    tried = {"name": "dropo", "epsilon": [1e-6, 1e-4, 1e-2]}
    final = iterations(smoke(tried), stages)[-1]
    errors = final.diagnostics["mean_squared_error_by_epsilon"]
    assert set(errors) == {"1e-06", "0.0001", "0.01"}
    assert final.diagnostics["mean_squared_error"] == min(errors.values())
    searches = [s for s in stages.executed if s.kind == "infer"]
    assert len(searches) == 3
    assert len([s for s in stages.executed if s.kind == "train_policy"]) == 2


def test_bayrn_starts_from_udrs_policies_and_sees_returns_alone():
    stages = LocalStages()
    list(run(smoke("udr"), stages))
    trained = [s.digest for s in stages.executed if s.kind == "train_policy"]
    first, last = iterations(smoke("bayrn"), stages)
    new = [s for s in stages.executed if s.kind == "train_policy" and s.digest not in trained]
    assert len(new) == 1  # one per iteration
    assert (first.target_rollouts, last.target_rollouts) == (2, 3)
    for stage in stages.executed:
        if stage.kind == "propose":
            assert not stage.blobs
            assert len(stage.inputs["returns"]) == len(stage.inputs["distributions"])
    assert last.policies[0] in {*first.policies, *last.policies}
    seen = last.diagnostics["returns_seen"]
    assert len(seen) == 3
    assert last.diagnostics["reported"] == int(np.argmax(last.diagnostics["posterior_means"]))


def test_simopt_1_learns_from_the_priors_policy_alone():
    stages = LocalStages()
    final = iterations(smoke("simopt_1", iterations=2), stages)[-1]
    rollouts = [s for s in stages.executed if s.kind == "target_rollout"]
    assert len({s.document["blobs"]["policy"] for s in rollouts}) == 1
    assert final.target_rollouts == len(rollouts) == 2
    searches = [s for s in stages.executed if s.kind == "infer"]
    assert searches[0].inputs["state"] == searches[1].inputs["state"]  # the prior


class TestResults:
    def test_the_table_has_every_method_with_its_interval_and_counts(self, benchmark):
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
            assert row.low <= row.normalised_return <= row.high
            assert (row.seeds, row.episodes) == (2, 4 * row.policies)
        simopt = [row for row in rows if (row.method, row.variant) == ("simopt", "vanilla")]
        assert [row.target_transitions for row in simopt] == [0, 20, 40, 60]
        assert simopt[0].posterior_std == 1
        assert simopt[-1].posterior_std < 1
        assert all(
            row.posterior_std == 0 for row in rows if row.method == "sysid" and row.iteration
        )

    def test_every_pair_of_methods_is_compared_after_its_last_iteration(self, benchmark):
        found = comparisons(benchmark[2])
        for pair in found:
            assert 0 <= pair.low <= pair.probability <= pair.high <= 1
            assert pair.seeds == 2
        names = {run.column for run in benchmark[0].runs()}
        assert len(names) == 6 + 3 * 3
        assert len(found) == 2 * len(names) * (len(names) - 1) // 2

    def test_the_prior_is_iteration_zero_of_every_method(self, benchmark):
        rows = table(benchmark[2])
        prior = {row.variant: row for row in rows if row.method == "prior"}
        for row in rows:
            if row.method in {"simopt", "dropo"} and row.iteration == 0:
                assert row.normalised_return == prior[row.variant].normalised_return

    def test_outcomes_in_any_order_give_the_same_csv(self, benchmark):
        outcomes = benchmark[2]
        assert to_csv(table(outcomes)) == to_csv(table(outcomes[::-1]))

    def test_estimates_name_every_parameter_with_its_truth(self, benchmark):
        found = estimates(benchmark[2])
        assert {(e.parameter, e.truth) for e in found} == {
            ("upper_mass", 1.0),
            ("fore_mass", 0.7),
            ("shoulder_friction", 2.0),
            ("elbow_friction", 1.0),
        }

    @pytest.mark.parametrize("name", FIGURES)
    def test_figures_repeat_byte_for_byte(self, benchmark, name):
        svg = draw(name, benchmark[2], "svg")
        assert svg == draw(name, benchmark[2], "svg")
        assert b"</svg>" in svg
        assert draw(name, benchmark[2], "png").startswith(b"\x89PNG")

    def test_the_papers_four_figures_and_three_more_can_be_drawn(self, benchmark):
        names = [f"returns-{variant}" for variant in ("vanilla", "noisy")]
        assert drawable(benchmark[2]) == [*names, "collection", "parameters", "spread", "cost"]
        alone = [o for o in benchmark[2] if o.spec.variant == "noisy"]
        assert draw("returns-noisy", benchmark[2], "png") == draw("returns", alone, "png")
        with pytest.raises(UnknownName, match="vanilla, noisy"):
            draw("returns-windy", benchmark[2], "png")

    def test_the_csv_of_a_figure_has_the_numbers_it_draws(self, benchmark):
        read = csv.DictReader(io.StringIO(draw("spread-vanilla", benchmark[2], "csv").decode()))
        drawn = list(read)
        assert {row["method"] for row in drawn} == {"simopt", "simopt_1", "droid", "dropo"}
        assert {row["normalised_std"] for row in drawn if row["iteration"] == "0"} == {"1.0"}
        assert {row["parameter"] for row in drawn} == set(source_of("arm", "vanilla").space.names)

    def test_inferences_have_their_cost(self, benchmark):
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

    def test_a_figure_of_nothing_or_of_no_such_name_is_refused(self, benchmark):
        with pytest.raises(InvalidInput, match="nothing to draw"):
            draw("returns", [], "svg")
        with pytest.raises(UnknownName, match="returns, collection, parameters"):
            draw("return", benchmark[2], "svg")


def _drain(program):
    while True:
        try:
            next(program)
        except StopIteration as stop:
            return stop.value


def _policies(stages):
    """The bytes of a policy trained for a moment."""
    from adr_service.runs import _OnlineLoop

    spec = smoke("simopt")
    yield _drain(_OnlineLoop(spec, stages, Target(spec, stages)).train()).blobs["policy"]

"""The paper's claims are judged by the numbers: planted results give the verdict they should."""

import numpy as np
import pytest

from adr_service.benchmark.claims import CLAIMS, reports
from adr_service.benchmark.comparison import Outcome
from adr_service.distributions import Gaussian
from adr_service.events import IterationFinished
from adr_service.specs import RunSpec
from adr_service.tasks.catalogue import get_task, source_of

ALL = ("udr", "bayrn", "simopt", "simopt_1", "droid", "dropo")


def outcomes(method, level, iteration=1, *, task="hopper", variant="vanilla", **more):
    """Three seeds whose normalised returns are about `level`."""
    steps, std = more.pop("steps", 0), more.pop("std", 1.0)
    space = source_of(task, variant).space
    belief = Gaussian(space, np.full(len(space), 2.0), std**2 * np.eye(len(space)))
    found = []
    for seed in range(3):
        given = {"task": task, "variant": variant, "method": method, "seed": seed}
        spec = RunSpec.model_validate({"preset": "demo", **given, **more})
        rng = np.random.default_rng([seed, iteration])
        returns = get_task(task).reward_threshold * rng.normal(level, 0.02, 50)
        event = IterationFinished(
            iteration=iteration,
            target_rollouts=iteration,
            target_transitions=200 * iteration,
            evaluation_episodes=50,
            distributions=[belief.to_json()],
            policies=["p"],
            source_returns=[1.0],
            reached_threshold=[True],
            training_steps=[1],
            inference_steps=steps,
            inferences=["i"],
            returns=[returns.tolist()],
            diagnostics={},
        )
        found.append(Outcome(spec, event))
    return found


def verdict(name, found):
    (report,) = reports(found)
    finding = next(f for f in report.findings if f.claim == name)
    return finding.verdict


def everything(levels, **more):
    return [o for method in ALL for o in outcomes(method, levels.get(method, 1.0), **more)]


@pytest.mark.parametrize(
    ("levels", "expected"),
    [({}, "supported"), ({"udr": 0.4}, "contradicted"), ({"udr": 0.95}, "undecided")],
)
def test_every_method_must_solve_the_task(levels, expected):
    assert verdict("V1", everything(levels)) == expected


def test_what_was_not_run_is_not_measured_whatever_else_was():
    found = [o for o in everything({}) if o.spec.method.name != "droid"]
    assert verdict("V1", found) == "not measured"
    (report,) = reports(found)
    assert any("simopt on hopper vanilla: 1.00" in line for line in report.findings[0].evidence)
    assert {f.claim for f in report.findings} == {claim.name for claim in CLAIMS}


def test_a_failure_is_claimed_and_judged():
    assert verdict("V4", outcomes("simopt_1", 0.3, task="walker2d")) == "supported"
    assert verdict("V4", outcomes("simopt_1", 1.0, task="walker2d")) == "contradicted"


def test_more_data_making_it_worse_is_a_drop_between_two_iterations():
    def droid(*levels):
        return [
            outcome
            for i, level in enumerate(levels, 1)
            for outcome in outcomes("droid", level, i, task="walker2d")
        ]

    steady = [
        outcome
        for task in ("hopper", "half_cheetah", "walker2d", "humanoid")
        for i in (1, 2)
        for outcome in outcomes("simopt", 1.0, i, task=task)
    ]
    assert verdict("V5", droid(0.5, 0.9, 0.3) + steady) == "supported"
    assert verdict("V5", droid(0.5, 0.9, 1.0) + steady) == "contradicted"
    assert verdict("V5", droid(0.5) + steady) == "not measured"


def test_a_difference_is_judged_by_its_interval():
    others = [name for name in ALL if name != "bayrn"]
    rest = [o for name in others for o in outcomes(name, 0.8, variant="unmodeled")]
    assert verdict("U3", outcomes("bayrn", 1.0, variant="unmodeled") + rest) == "supported"
    assert verdict("U3", outcomes("bayrn", 0.6, variant="unmodeled") + rest) == "contradicted"


def test_collectors_are_compared_with_each_other():
    def study(random):
        levels = {"simopt": 1.0, "prior": 1.0, "random": random}
        return [
            outcome
            for method in ("droid", "dropo")
            for collector, level in levels.items()
            for outcome in outcomes(method, level, variant="noisy", collector=collector)
        ]

    assert verdict("D1", study(1.0)) == "supported"
    assert verdict("D1", study(0.5)) == "contradicted"


def test_a_narrow_distribution_is_one():
    found = [
        outcome
        for task in ("hopper", "half_cheetah", "walker2d", "humanoid")
        for outcome in outcomes("droid", 1.0, task=task, variant="unmodeled", std=0.01)
    ]
    assert verdict("U5", found) == "supported"
    wide = outcomes("droid", 1.0, task="hopper", variant="unmodeled", std=0.5)
    assert verdict("U5", found[3:] + wide) == "contradicted"


def test_budgets_are_not_mixed_and_smoke_does_not_count():
    two = everything({}) + everything({"udr": 0.4}, transitions=100)
    found = {str(report.changed): report.findings[0].verdict for report in reports(two)}
    assert found == {"{}": "supported", "{'transitions': 100}": "contradicted"}
    assert reports(everything({}, preset="smoke")) == []


def test_of_equal_runs_the_latest_counts():
    assert verdict("V1", everything({"udr": 0.4}) + everything({})) == "supported"

"""The paper's claims are judged by the numbers: planted results give the verdict they should."""

import numpy as np
import pytest

from adr_service.benchmark.claims import CLAIMS, Measured, reports
from adr_service.benchmark.comparison import Outcome
from adr_service.distributions import Gaussian
from adr_service.events import IterationFinished
from adr_service.specs import RunSpec
from adr_service.tasks.catalogue import get_task, source_of

ALL = ("udr", "bayrn", "simopt", "simopt_1", "droid", "dropo")
TASKS = ("hopper", "half_cheetah", "walker2d", "humanoid")
VARIANTS = ("vanilla", "noisy", "unmodeled")
STEPS = {"dropo": 3000, "simopt": 2000, "simopt_1": 2000, "droid": 1000}
HARD = TASKS[1:]


def outcome(level, std=0.01, steps=0, *, iteration=2, seed=0, method="simopt", **given):
    """A run's iteration whose normalised returns are about `level`."""
    settings = {"name": method, **given.pop("settings", {})}
    given = {"task": "hopper", "variant": "vanilla", **given}
    spec = RunSpec.model_validate({"preset": "demo", "seed": seed, "method": settings, **given})
    space = source_of(spec.task, spec.variant).space
    belief = Gaussian(space, np.full(len(space), 2.0), std**2 * np.eye(len(space)))
    returns = np.random.default_rng([seed, iteration]).normal(level, 0.01, 10)
    event = IterationFinished(
        iteration=iteration,
        target_rollouts=iteration,
        target_transitions=200 * iteration,
        evaluation_episodes=10,
        distributions=[belief.to_json()],
        policies=["p"],
        source_returns=[1.0],
        reached_threshold=[True],
        training_steps=[1],
        inference_steps=steps,
        inferences=["i"],
        returns=[(returns * get_task(spec.task).reward_threshold).tolist()],
        diagnostics={},
    )
    return Outcome(spec, event)


def level_of_the_paper(task, variant, method, iteration, collector):
    """Returns as the paper describes them (demo has two iterations); the first rule that fits."""
    hard, walker = task in HARD, task == "walker2d"
    rules = [
        (iteration == 0 and method != "udr", 0.3),
        (method == "droid" and walker and collector != "simopt", 0.2),
        (method == "droid" and walker and variant == "noisy", 0.5),
        (method == "droid" and walker and variant == "vanilla" and iteration == 1, 1.3),
        (method == "simopt_1" and walker and variant != "unmodeled", 0.5),
        (method in {"simopt", "simopt_1"} and (task, variant) == ("humanoid", "unmodeled"), 0.5),
        (method == "bayrn" and hard and variant != "unmodeled", 0.5),
        (method == "bayrn" and (task, variant) == ("hopper", "unmodeled"), 1.05),
        (method == "simopt" and (task, variant, iteration) == ("humanoid", "noisy", 1), 0.9),
        (method == "simopt" and hard and variant == "noisy", 0.8),
        (method == "simopt" and iteration == 1, 0.7),
        (method == "dropo", 1.02),
    ]
    return next((level for fits, level in rules if fits), 1.0)


def world(change=lambda *cell: None):
    """All that the claims speak of; `change` gives another level, or None for the paper's."""
    found = []
    for task in TASKS:
        for variant in VARIANTS:
            for method in ALL:
                study = method in {"droid", "dropo"} and variant == "noisy"
                for collector in ("simopt", "prior", "random") if study else ("simopt",):
                    for iteration in (0,) if method == "udr" else (0, 1, 2):
                        cell = (task, variant, method, iteration, collector)
                        level = change(*cell)
                        if level is None:
                            level = level_of_the_paper(*cell)
                        found += [
                            outcome(
                                level,
                                steps=STEPS.get(method, 0),
                                task=task,
                                variant=variant,
                                method=method,
                                collector=collector,
                                iteration=iteration,
                                seed=seed,
                            )
                            for seed in (0, 1)
                        ]
    return found


def verdict(name, found):
    (claim,) = [claim for claim in CLAIMS if claim.name == name]
    return claim.judge(Measured(found)).verdict


@pytest.fixture(scope="module")
def papers_world():
    return world()


@pytest.mark.parametrize("name", [claim.name for claim in CLAIMS])
def test_results_like_the_papers_support_each_claim(papers_world, name):
    assert verdict(name, papers_world) == "supported"


CONTRADICTIONS = {
    "V1": lambda t, v, m, i, c: 0.4 if (t, v, m) == ("hopper", "vanilla", "udr") else None,
    "V2": lambda t, v, m, i, c: (
        0.5 if (t, v, m, i) == ("humanoid", "vanilla", "dropo", 1) else None
    ),
    "V3": lambda t, v, m, i, c: 1.2 if (t, v, m, i) == ("hopper", "vanilla", "simopt", 0) else None,
    "V4": lambda t, v, m, i, c: 1.0 if (t, v, m) == ("walker2d", "vanilla", "simopt_1") else None,
    "V5": lambda t, v, m, i, c: 1.0 if (t, v, m) == ("walker2d", "vanilla", "droid") else None,
    "V6": lambda t, v, m, i, c: 1.0 if (t, v, m) == ("half_cheetah", "vanilla", "bayrn") else None,
    "N1": lambda t, v, m, i, c: 0.5 if (t, v, m) == ("hopper", "noisy", "simopt_1") else None,
    "N2": lambda t, v, m, i, c: 1.0 if (t, v, m) == ("walker2d", "noisy", "droid") else None,
    "N3": lambda t, v, m, i, c: 1.0 if (t, v, m) == ("walker2d", "noisy", "bayrn") else None,
    "N4": lambda t, v, m, i, c: 1.2 if (t, v, m) == ("walker2d", "noisy", "simopt") else None,
    "N5": lambda t, v, m, i, c: 0.8 if (t, v, m, i) == ("hopper", "noisy", "dropo", 2) else None,
    "U1": lambda t, v, m, i, c: 0.5 if (t, v, m) == ("hopper", "unmodeled", "droid") else None,
    "U2": lambda t, v, m, i, c: 1.0 if (t, v, m) == ("humanoid", "unmodeled", "simopt") else None,
    "U3": lambda t, v, m, i, c: 0.9 if (t, v, m) == ("hopper", "unmodeled", "bayrn") else None,
    "U4": lambda t, v, m, i, c: 1.3 if (t, v, m) == ("walker2d", "unmodeled", "simopt") else None,
    "D1": lambda t, v, m, i, c: 0.5 if (t, m, c) == ("hopper", "dropo", "random") else None,
    "D2": lambda t, v, m, i, c: 0.5 if (t, m, c) == ("walker2d", "dropo", "random") else None,
    "C2": lambda t, v, m, i, c: 1.2 if (t, v, m, i) == ("hopper", "vanilla", "simopt", 1) else None,
    "C3": lambda t, v, m, i, c: 1.5 if m == "udr" else None,
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_one_result_against_it_contradicts_a_claim(name):
    assert verdict(name, world(CONTRADICTIONS[name])) == "contradicted"


def hopper(levels, seeds=(0, 1, 2), **given):
    """All methods on vanilla Hopper."""
    return [
        outcome(levels.get(m, 1.0), method=m, seed=s, iteration=0 if m == "udr" else 2, **given)
        for m in ALL
        for s in seeds
    ]


def test_widths_and_costs_must_hold_for_every_seed():
    def droid(*stds):
        given = {"method": "droid", "variant": "unmodeled"}
        return [
            outcome(1.0, std, task=task, seed=seed, **given)
            for task in TASKS
            for seed, std in enumerate(stds)
        ]

    assert verdict("U5", droid(0.01, 0.02)) == "supported"
    assert verdict("U5", droid(0.5, 0.4)) == "contradicted"
    assert verdict("U5", droid(0.01, 0.4)) == "undecided"
    given = {"iteration": 1, "seed": 0}
    steps = {**STEPS, "dropo": 10}
    cheap = [
        outcome(1.0, steps=steps[m], method=m, task=t, **{**given, "seed": s})
        for m in ("dropo", "simopt", "droid")
        for t in TASKS
        for s in (0, 1)
    ]
    assert verdict("C1", cheap) == "contradicted"


def test_what_was_not_run_is_not_measured_whatever_else_was():
    found = [o for o in hopper({}) if o.spec.method.name != "droid"]
    assert verdict("V1", found) == "not measured"
    (report,) = reports(found)
    assert any("simopt on hopper vanilla: 1.00" in line for line in report.findings[0].evidence)


def test_what_an_interval_does_not_settle_is_undecided():
    assert verdict("V1", hopper({"udr": 0.95})) == "undecided"


def test_one_seed_settles_nothing():
    assert verdict("V1", hopper({}, seeds=(0,))) == "undecided"
    assert verdict("V1", hopper({"udr": 0.1}, seeds=(0,))) == "undecided"


def test_a_run_that_still_goes_on_is_not_judged_by_where_it_is():
    ahead = outcome(1.0, method="simopt_1", task="walker2d", seed=0, iteration=2)
    behind = [
        outcome(0.3, method="simopt_1", task="walker2d", seed=s, iteration=1) for s in (0, 1, 2)
    ]
    assert verdict("V4", behind) == "not measured"
    assert verdict("V4", [*behind, ahead]) == "undecided"


def test_after_one_iteration_nothing_was_gained_by_more():
    one = [
        outcome(1.0, method="dropo", variant="noisy", task=t, seed=s, iteration=1, iterations=1)
        for t in TASKS
        for s in (0, 1)
    ]
    assert verdict("N5", one) == "not measured"


def test_budgets_are_not_mixed_and_smoke_does_not_count():
    two = hopper({}) + hopper({"udr": 0.4}, transitions=100)
    found = {str(report.changed): report.findings[0].verdict for report in reports(two)}
    assert found == {"{}": "supported", "{'transitions': 100}": "contradicted"}
    assert reports(hopper({}, preset="smoke", iterations=2)) == []


def test_a_single_run_with_other_settings_changes_nothing():
    other = outcome(0.1, method="dropo", settings={"budget": 2})
    assert verdict("V1", [*hopper({}), other]) == "supported"
    worse = [outcome(0.1, method="dropo", settings={"budget": 2}, seed=s) for s in range(4)]
    assert verdict("V1", [*hopper({}), *worse]) == "contradicted"


def test_of_equal_runs_the_latest_counts():
    assert verdict("V1", hopper({"udr": 0.4}) + hopper({})) == "supported"

"""Presets are complete, valid, and grow from seconds to weeks."""

import pytest

from adr_service.methods.catalogue import methods
from adr_service.presets import PRESETS
from adr_service.specs import RunSpec
from adr_service.tasks.catalogue import catalogue

# the smallest presets train for less than a rollout of PPO's defaults
SHORT = {"ppo": {"rollout_steps": 4, "batch_size": 32}}


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("method", ["udr", "bayrn", "simopt", "simopt_1", "droid", "dropo"])
def test_every_preset_gives_every_method_a_valid_run(preset, method):
    spec = RunSpec.model_validate({"task": "arm", "preset": preset, "method": method})
    expected = PRESETS[preset]["methods"].get(method, {})
    given = spec.method.model_dump(mode="json")
    assert {name: given[name] for name in expected} == expected


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_sets_methods_that_exist(preset):
    assert set(PRESETS[preset]["methods"]) <= set(methods())


def test_presets_stand_in_the_order_of_their_budgets():
    specs = [
        RunSpec.model_validate({"task": "hopper", "preset": preset, "method": "udr"})
        for preset in PRESETS
    ]
    budgets = [(spec.iterations, spec.training.max_steps) for spec in specs]
    assert budgets == sorted(budgets)
    assert list(PRESETS) == ["smoke", "demo", "quick", "fast", "paper"]


@pytest.mark.parametrize("task", catalogue())
def test_quick_and_fast_have_the_same_trainings(task):
    quick, fast = (
        RunSpec.model_validate({"task": task, "preset": preset, "method": "udr"}).training
        for preset in ("quick", "fast")
    )
    assert quick == fast
    assert fast.algorithm != "sac"


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("algorithm", ["sac", "crossq", "ppo"])
def test_another_algorithm_has_the_presets_budget_and_its_own_hyperparameters(preset, algorithm):
    given = {"task": "humanoid", "preset": preset, "method": "udr"}
    usual = RunSpec.model_validate(given).training
    other = RunSpec.model_validate(
        {**given, "training": {"algorithm": algorithm, **SHORT.get(algorithm, {})}}
    ).training
    assert other.algorithm == algorithm
    assert (other.max_steps, other.backend) == (usual.max_steps, usual.backend)
    if algorithm != "ppo":
        assert other.learning_starts < other.max_steps
    if usual.algorithm == algorithm == "crossq":
        assert other == usual


def test_a_value_of_the_spec_wins_over_its_preset():
    spec = {"task": "arm", "method": "udr", "preset": "smoke", "transitions": 33}
    assert RunSpec.model_validate(spec).transitions == 33

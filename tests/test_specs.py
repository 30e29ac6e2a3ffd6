from typing import ClassVar

import pytest
from pydantic import ValidationError

from adr_service.methods.simopt import SimOptSettings
from adr_service.presets import PRESETS
from adr_service.specs import BenchmarkSpec, ExternalTarget, RunSpec

GOOD = {"task": "arm", "method": "simopt", "preset": "smoke"}


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("method", ["udr", "simopt", "dropo", "prior", "oracle"])
def test_every_preset_completes_a_spec_that_survives_json(preset, method):
    spec = RunSpec.model_validate({"task": "hopper", "method": method, "preset": preset})
    assert RunSpec.model_validate_json(spec.model_dump_json()) == spec


def test_the_paper_preset_is_the_papers_protocol():
    """Tiboni et al., Sec. 3.2 and 3.4."""
    spec = RunSpec.model_validate({"task": "hopper", "method": "simopt", "preset": "paper"})
    assert (spec.iterations, spec.transitions, spec.evaluation_episodes) == (5, 200, 100)
    assert (spec.method.updates, spec.method.samples) == (5, 1000)
    training = spec.training
    assert (training.max_steps, training.environments) == (5_000_000, 12)
    assert (training.hidden, training.activation, training.gradient_steps) == (
        [128, 128],
        "tanh",
        1,
    )
    dropo = RunSpec.model_validate({"task": "hopper", "method": "dropo", "preset": "paper"})
    assert dropo.method.samples_per_parameter == 10
    udr = RunSpec.model_validate({"task": "hopper", "method": "udr", "preset": "paper"})
    assert udr.method.policies == 10


def test_what_is_given_wins_over_the_preset_field_by_field():
    spec = RunSpec.model_validate(
        {**GOOD, "method": {"name": "simopt", "samples": 17}, "training": {"max_steps": 500}}
    )
    assert (spec.method.samples, spec.method.updates) == (17, 2)
    assert (spec.training.max_steps, spec.training.batch_size) == (500, 32)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"task": "hoper"},
            "there is no task 'hoper'; did you mean 'hopper'? accepted: arm, hopper",
        ),
        ({"method": "simop"}, "did you mean 'simopt'? accepted: udr, bayrn, simopt, simopt_1"),
        ({"variant": "windy"}, "accepted: vanilla, noisy, unmodeled"),
        ({"preset": "huge"}, "accepted: smoke, demo, quick, paper"),
        ({"iterations": -1}, "greater than or equal to 1"),
        ({"seed": 1.5}, "valid integer"),
        ({"seed": "1"}, "valid integer"),
        ({"seed": True}, "valid integer"),
        ({"sed": 1}, "there is no field 'sed'; did you mean 'seed'?"),
        ({"training": {"max_step": 1}}, "did you mean 'max_steps'?"),
        ({"training": {"gamma": float("nan")}}, "finite number"),
        ({"training": {"learning_rate": float("inf")}}, "finite number"),
        ({"method": {"name": "simopt", "budget": 3}}, "there is no field 'budget'"),
        ({"method": 3}, "give a method's name, or its settings with `name`; accepted: udr"),
        ({"method": {"updates": 3}}, "or its settings with `name`"),
        ({"method": "dropo", "simopt": "simop"}, "should be 'simopt'"),
        ({"method": "drop", "simopt": "simopt"}, "did you mean 'dropo'?"),
        ({"collector": "x"}, "should be 'simopt', 'prior', 'random' or 'recording'"),
        ({"preset": 3}, "valid string"),
        ({"training": 3}, "valid dictionary"),
        ({"training": {"hidden": [0]}}, "greater than or equal to 1"),
        ({"transitions": 201}, "an episode of arm has 200 steps at most"),
        ({"task": None}, "valid string"),
    ],
    ids=str,
)
def test_a_mistake_is_one_error_at_its_field_with_what_is_accepted(change, message):
    with pytest.raises(ValidationError) as refused:
        RunSpec.model_validate({**GOOD, **change})
    (error,) = refused.value.errors()
    assert message in error["msg"]
    place = error["loc"] or [error["msg"].removeprefix("Value error, ").partition(":")[0]]
    assert place[0] in change or "'sed'" in error["msg"]


def test_values_of_ours_are_as_good_as_their_json():
    assert RunSpec.model_validate({**GOOD, "target": ExternalTarget()}).target == ExternalTarget()
    for named in (SimOptSettings(samples=40), SimOptSettings(name="simopt", samples=40)):
        spec = RunSpec.model_validate({**GOOD, "method": named})
        assert spec.method == SimOptSettings(updates=2, samples=40)  # the rest is the preset's
    grid = {"tasks": ["arm"], "methods": [SimOptSettings(samples=40)], "preset": "smoke"}
    assert BenchmarkSpec.model_validate({**grid, "references": False, "seeds": [0]}).size == 1


class TestBenchmark:
    def spec(self, **changes):
        return BenchmarkSpec.model_validate(
            {"tasks": ["arm"], "methods": ["udr", "simopt"], "preset": "smoke", **changes}
        )

    def test_it_expands_to_the_grid_and_its_references(self):
        runs = list(self.spec(variants=["vanilla", "noisy"], seeds=[0, 1]).runs())
        assert len(runs) == 2 * 2 * 4
        assert {run.method.name for run in runs} == {"udr", "simopt", "prior", "oracle"}
        assert len(list(self.spec(references=False, seeds=[0]).runs())) == 2

    @pytest.mark.parametrize(
        ("change", "place", "message"),
        [
            ({"preset": "smok"}, ("preset",), "did you mean 'smoke'?"),
            ({"tasks": ["arm", "leg"]}, ("tasks", 1), "there is no task 'leg'"),
            ({"methods": ["udr", "simop"]}, ("methods", 1), "did you mean 'simopt'?"),
            ({"methods": [{"name": "simop"}]}, ("methods", 0), "did you mean 'simopt'?"),
            ({"variants": ["windy"]}, ("variants", 0), "accepted: vanilla, noisy, unmodeled"),
            ({"seeds": [0, -1]}, ("seeds", 1), "greater than or equal to 0"),
            (
                {"methods": [{"name": "simopt", "sample": 1}]},
                ("methods", 0, "settings", "simopt"),
                "did you mean 'samples'?",
            ),
        ],
        ids=str,
    )
    def test_a_mistake_is_one_error_at_its_place(self, change, place, message):
        with pytest.raises(ValidationError) as refused:
            self.spec(**change)
        (error,) = refused.value.errors()
        assert error["loc"] == place
        assert message in error["msg"]

    def test_a_methods_other_settings_stay_the_presets(self):
        spec = self.spec(methods=[{"name": "simopt", "updates": 1}], references=False, seeds=[0])
        for known in (
            spec,
            BenchmarkSpec.model_validate_json(spec.model_dump_json(exclude_unset=True)),
        ):
            (run,) = known.runs()
            assert (run.method.updates, run.method.samples) == (1, 20)

    def test_overrides_reach_every_run(self):
        for run in self.spec(iterations=3, training={"max_steps": 700}).runs():
            assert (run.iterations, run.training.max_steps) == (3, 700)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"seeds": []}, "at least 1 item"),
            ({"seeds": [0, 0]}, "must not repeat"),
            ({"seeds": [-1]}, "greater than or equal to 0"),
            ({"methods": ["udr", {"name": "udr", "policies": 3}]}, "must not repeat a member"),
            ({"methods": ["magic"]}, "there is no method 'magic'"),
            ({"tasks": ["arm", "leg"]}, "there is no task 'leg'"),
            ({"seeds": list(range(5000))}, "5000 runs at most; this has 20000"),
            ({"training": {"nets": 1}}, "there is no field 'nets'"),
        ],
    )
    def test_a_bad_cell_refuses_the_whole(self, change, message):
        with pytest.raises(ValidationError) as refused:
            self.spec(**change)
        assert message in str(refused.value)


class TestWhoCollects:
    given: ClassVar = {"tasks": ["arm"], "seeds": [0], "preset": "smoke", "references": False}

    def test_an_offline_run_names_the_simopt_that_it_learns_from(self):
        spec = RunSpec.model_validate({"task": "arm", "method": "droid", "preset": "smoke"})
        assert spec.simopt == SimOptSettings(updates=2, samples=20)  # the preset's
        assert RunSpec.model_validate_json(spec.model_dump_json()) == spec
        other = {"task": "arm", "method": "droid", "preset": "smoke", "simopt": {"name": "simopt"}}
        other["simopt"]["samples"] = 30
        assert RunSpec.model_validate(other).simopt == SimOptSettings(updates=2, samples=30)

    def test_in_a_benchmark_it_is_the_benchmarks_own(self):
        methods = [{"name": "simopt", "samples": 33}, "dropo"]
        simopt, dropo = BenchmarkSpec.model_validate({**self.given, "methods": methods}).runs()
        assert dropo.simopt == simopt.method
        assert simopt.simopt is None

    def test_nobody_else_has_one(self):
        collectors = {**self.given, "methods": ["dropo"], "collectors": ["prior", "random"]}
        assert [run.simopt for run in BenchmarkSpec.model_validate(collectors).runs()] == [None] * 2
        given = {"task": "arm", "method": "udr", "preset": "smoke", "simopt": {"name": "simopt"}}
        with pytest.raises(ValidationError, match="learns nothing from SimOpt"):
            RunSpec.model_validate(given)

import json
from typing import ClassVar

import pytest
from pydantic import ValidationError

from adr_service.events import (
    FINISHED,
    IterationFinished,
    RunFailed,
    RunQueued,
    RunStarted,
    RunStopped,
    RunSucceeded,
    StageFinished,
    TrainingEvaluated,
    event_from_json,
    state_after,
)
from adr_service.methods.simopt import SimOptSettings
from adr_service.presets import PRESETS
from adr_service.specs import BenchmarkSpec, ExternalTarget, RunSpec
from adr_service.stages import Stage

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


class TestStageDigest:
    stage = Stage("evaluate", {"task": "arm", "seed": 1, "x": [0.1, 2]}, {"policy": b"abc"})

    def test_it_does_not_depend_on_the_order_of_inputs(self):
        other = Stage("evaluate", {"x": [0.1, 2], "seed": 1, "task": "arm"}, {"policy": b"abc"})
        assert other.digest == self.stage.digest

    @pytest.mark.parametrize(
        "other",
        [
            Stage("train_policy", stage.inputs, stage.blobs),
            Stage("evaluate", {**stage.inputs, "seed": 2}, stage.blobs),
            Stage("evaluate", stage.inputs, {"policy": b"abd"}),
            Stage("evaluate", stage.inputs, {"other": b"abc"}),
        ],
        ids=["kind", "input", "bytes", "name"],
    )
    def test_it_depends_on_everything_that_matters(self, other):
        assert other.digest != self.stage.digest

    def test_it_is_a_promise_to_stored_results(self):
        """Changing it makes every stored stage run again: bump a version instead."""
        expected = "75f4d711f349d5c56532c38a5ce1c611fb05ada589a67f09524f5240a7d0a959"
        assert self.stage.digest == expected


EVENTS = [
    RunQueued(submission=1),
    RunStarted(submission=1),
    StageFinished(kind="evaluate", digest="0" * 64),
    TrainingEvaluated(digest="0" * 64, steps=40, mean_return=1 / 3, standard_error=0.0),
    IterationFinished(
        iteration=1,
        target_rollouts=1,
        target_transitions=20,
        evaluation_episodes=2,
        distributions=[{"kind": "uniform", "low": [0.1], "high": [1 / 3]}],
        policies=["a"],
        source_returns=[1.5],
        reached_threshold=[False],
        training_steps=[600],
        inference_steps=0,
        returns=[[1.0, 2.0]],
        diagnostics={"a": [None, 1e-300]},
    ),
    RunFailed(submission=1, code="worker_lost", message="gone"),
    RunStopped(submission=1),
    RunSucceeded(),
]


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: event.type)
def test_events_survive_json(event):
    assert event_from_json(event.model_dump_json()) == event
    assert json.loads(event.model_dump_json())["type"] == event.type


def test_the_state_is_the_fold_of_the_events():
    queued, started, stage, curve, _, failed, stopped, succeeded = EVENTS
    assert state_after([queued]) == "queued"
    assert state_after([queued, started, stage, curve]) == "running"
    assert state_after([queued, started, failed]) == "failed"
    assert state_after([queued, started, failed, RunQueued(submission=2)]) == "queued"
    assert state_after([queued, started, stopped]) == "cancelled"
    assert state_after([queued, started, succeeded]) == "succeeded"
    assert state_after([]) not in FINISHED


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

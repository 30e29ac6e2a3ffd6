from typing import ClassVar

import pytest
from pydantic import ValidationError

from adr_service.methods.simopt import SimOptSettings
from adr_service.specs import BenchmarkSpec, RunSpec
from adr_service.training.settings import PpoSettings, SacSettings

GOOD = {"task": "arm", "method": "simopt", "preset": "smoke"}


class TestTrainings:
    @pytest.mark.parametrize(
        ("preset", "algorithm"), [("smoke", "sac"), ("demo", "ppo"), ("paper", "sac")]
    )
    def test_the_algorithm_of_a_preset_may_be_given_too(self, preset, algorithm):
        given = {"task": "hopper", "method": "prior", "preset": preset}
        named = {**given, "training": {"algorithm": algorithm}}
        assert RunSpec.model_validate(named) == RunSpec.model_validate(given)

    def test_another_algorithm_takes_the_budget_of_the_preset_alone(self):
        given = {"task": "humanoid", "method": "prior", "preset": "fast"}
        assert RunSpec.model_validate(given).training.hidden == [256, 256]
        training = {"algorithm": "ppo"}
        filled = RunSpec.model_validate({**given, "training": training}).training
        assert isinstance(filled, PpoSettings)
        assert (filled.max_steps, filled.hidden) == (1_000_000, [128, 128])

    def test_settings_of_a_class_are_of_its_algorithm(self):
        """Their algorithm is a default, and defaults are the preset's otherwise."""
        spec = RunSpec(task="hopper", method="prior", preset="fast", training=SacSettings(tau=0.01))
        assert isinstance(spec.training, SacSettings)
        assert spec.training.tau == 0.01


class TestWhoCollects:
    given: ClassVar = {"tasks": ["arm"], "seeds": [0], "preset": "smoke", "references": False}

    def test_an_offline_run_names_the_simopt_that_it_learns_from(self):
        spec = RunSpec.model_validate({"task": "arm", "method": "droid", "preset": "smoke"})
        assert spec.simopt == SimOptSettings(updates=2, samples=40)  # the preset's
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

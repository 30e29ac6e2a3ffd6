from typing import ClassVar

import pytest
from pydantic import ValidationError

from adr_service.methods.simopt import SimOptSettings
from adr_service.specs import BenchmarkSpec, RunSpec

GOOD = {"task": "arm", "method": "simopt", "preset": "smoke"}


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

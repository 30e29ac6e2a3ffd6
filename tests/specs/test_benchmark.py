import pytest
from pydantic import ValidationError

from adr_service.methods.dropo import DropoSettings
from adr_service.methods.simopt import SimOptSettings
from adr_service.specs import BenchmarkExtension, BenchmarkPart, BenchmarkSpec

GOOD = {"task": "arm", "method": "simopt", "preset": "smoke"}


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

    def test_as_json_it_has_the_same_runs(self):
        """The preset fills settings that were not given, and the class's defaults do not."""
        spec = self.spec(methods=[{"name": "dropo", "budget": 50}, "udr"], seeds=[0])
        assert spec.model_dump(mode="json")["methods"] == [{"name": "dropo", "budget": 50}, "udr"]
        again = BenchmarkSpec.model_validate_json(spec.model_dump_json())
        assert list(again.runs()) == list(spec.runs())

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
                ("methods", 0, "settings", "simopt", "sample"),
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
            assert (run.method.updates, run.method.samples) == (1, 40)

    def test_settings_of_a_class_keep_their_name_in_a_dump_of_what_was_given(self):
        spec = self.spec(methods=[SimOptSettings(updates=1)], references=False, seeds=[0])
        again = BenchmarkSpec.model_validate_json(spec.model_dump_json(exclude_unset=True))
        assert again == spec
        extension = BenchmarkExtension(methods=[DropoSettings(epsilon=1e-4)])
        longer = spec.extended(extension)
        assert longer.method_names == ["simopt", "dropo"]
        assert longer.part(BenchmarkPart(methods=["simopt"])) == spec
        assert extension.model_dump(exclude_unset=True) == {
            "methods": [{"name": "dropo", "epsilon": 1e-4}]
        }

    def test_overrides_reach_every_run(self):
        for run in self.spec(iterations=3, training={"max_steps": 700}).runs():
            assert (run.iterations, run.training.max_steps) == (3, 700)

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"seeds": []}, "at least 1 item"),
            ({"seeds": [0, 0]}, "must not repeat"),
            ({"seeds": [-1]}, "greater than or equal to 0"),
            (
                {"methods": ["udr", {"name": "udr", "policies": 3}]},
                "comes twice; submit each setting",
            ),
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

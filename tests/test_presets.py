"""Presets are complete, valid, and grow from seconds to weeks."""

import itertools

import pytest

from adr_service.methods.catalogue import methods
from adr_service.presets import PRESETS
from adr_service.specs import RunSpec


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


def test_each_preset_trains_longer_than_the_one_before():
    specs = [
        RunSpec.model_validate({"task": "hopper", "preset": preset, "method": "udr"})
        for preset in PRESETS
    ]
    steps = [spec.training.max_steps for spec in specs]
    assert all(fewer < more for fewer, more in itertools.pairwise(steps))
    assert list(PRESETS) == ["smoke", "demo", "quick", "paper"]


def test_a_value_of_the_spec_wins_over_its_preset():
    spec = {"task": "arm", "method": "udr", "preset": "smoke", "transitions": 33}
    assert RunSpec.model_validate(spec).transitions == 33

"""The form of a benchmark."""

import pytest

from adr_service.errors import InvalidInput
from adr_service.specs import BenchmarkSpec
from api.page.names import numbers_in
from api.page.submit import Given, as_filled_in, spec_of


def test_a_benchmark_comes_back_as_it_was_filled_in():
    given = Given(
        tasks=["arm"],
        variants=["vanilla", "noisy"],
        methods=["simopt", "droid"],
        collectors=["simopt", "random"],
        seeds="0 4",
        preset="demo",
        references=False,
        settings="iterations=2\ntraining.max_steps=20000",
    )
    assert as_filled_in(spec_of(given)) == given


def test_a_setting_that_is_null_comes_back():
    """A Gaussian policy, where the preset has bins."""
    null = {"tasks": ["hopper"], "methods": ["udr"], "training": {"action_bins": None}}
    spec = BenchmarkSpec.model_validate(null)
    assert list(spec_of(as_filled_in(spec)).runs()) == list(spec.runs())
    assert next(spec.runs()).training.action_bins is None


def test_settings_of_methods_are_not_in_the_form():
    method = {"name": "dropo", "budget": 100}
    spec = BenchmarkSpec.model_validate({"tasks": ["arm"], "methods": [method]})
    assert as_filled_in(spec).methods == ["dropo"]


def test_as_many_seeds_as_a_benchmark_may_have_are_filled_in():
    given = {"tasks": ["arm"], "methods": ["udr"], "seeds": list(range(5000)), "references": False}
    assert numbers_in(as_filled_in(BenchmarkSpec.model_validate(given)).seeds)[-1] == 4999


def test_seeds_are_numbers_with_spaces_or_commas_between():
    assert numbers_in("0, 1 2,3") == [0, 1, 2, 3]
    with pytest.raises(InvalidInput, match="given '-1'"):
        numbers_in("-1")
    with pytest.raises(InvalidInput, match="given '9999"):
        numbers_in("9" * 5000)

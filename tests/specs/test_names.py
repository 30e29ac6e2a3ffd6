import pytest
from pydantic import TypeAdapter, ValidationError

from adr_service.methods.catalogue import methods
from adr_service.methods.simopt import SimOptSettings
from adr_service.specs.names import NameOrSettings, PresetName, Seed, TaskName, as_given
from adr_service.tasks.catalogue import catalogue


@pytest.mark.parametrize("name", catalogue())
def test_every_task_of_the_catalogue_is_a_name(name):
    assert TypeAdapter(TaskName).validate_python(name) == name


@pytest.mark.parametrize(
    ("kind", "given", "close"),
    [(TaskName, "hoppr", "hopper"), (PresetName, "quik", "quick")],
)
def test_a_name_that_nothing_has_is_refused_with_the_nearest(kind, given, close):
    with pytest.raises(ValidationError, match=f"did you mean '{close}'"):
        TypeAdapter(kind).validate_python(given)


@pytest.mark.parametrize("name", methods())
def test_a_method_is_given_by_name_or_by_settings(name):
    either = TypeAdapter(NameOrSettings)
    assert either.validate_python(name) == name
    assert either.validate_python({"name": name}).name == name


@pytest.mark.parametrize("seed", [-1, 2**31, 1.0, "1", None])
def test_seeds_are_whole_numbers_of_31_bits(seed):
    with pytest.raises(ValidationError):
        TypeAdapter(Seed).validate_python(seed, strict=True)


def test_values_of_ours_are_taken_by_what_was_given_and_their_tag():
    assert as_given(SimOptSettings(samples=40)) == {"name": "simopt", "samples": 40}
    assert as_given({"samples": 40}) == {"samples": 40}

"""Entry points of installed packages, and those that lead nowhere."""

import math
from importlib.metadata import EntryPoint

import pytest

from adr_service.errors import InvalidInput
from adr_service.plugins import installed, load, origin, package_of


def test_an_entry_point_is_loaded():
    assert load(EntryPoint("pi", "math:pi", "adr_service.tasks")) is math.pi


@pytest.mark.parametrize(
    ("value", "cause"), [("nowhere:x", "ModuleNotFoundError"), ("math:tau2", "AttributeError")]
)
def test_an_entry_point_that_leads_nowhere_is_named_with_the_cause(value, cause):
    with pytest.raises(InvalidInput, match=f"'broken' = '{value}'.*cannot be loaded: {cause}"):
        load(EntryPoint("broken", value, "adr_service.tasks"))


def test_a_module_that_exits_is_named(tmp_path, monkeypatch):
    (tmp_path / "exits.py").write_text("import sys; sys.exit(3)")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidInput, match=r"'exits:x'.*cannot be loaded: SystemExit\(3\)"):
        load(EntryPoint("broken", "exits:x", "adr_service.tasks"))


def test_the_origin_of_an_entry_point_names_its_group():
    point = EntryPoint("cart", "own:ENTRY", "adr_service.tasks")
    assert origin(point) == "entry point 'cart' = 'own:ENTRY' (group adr_service.tasks)"


def test_a_group_without_packages_is_empty_and_its_names_are_ours():
    assert installed("adr_service.nothing") == []
    assert package_of("adr_service.nothing", "hopper") is None


def test_entry_points_are_sorted_by_name():
    names = [point.name for point in installed("console_scripts")]
    assert names == sorted(names)
    assert "pytest" in names

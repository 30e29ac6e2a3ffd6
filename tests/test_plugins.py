"""Entry points of installed packages, and those that lead nowhere."""

import math
from importlib.metadata import EntryPoint

import pytest

from adr_service.errors import InvalidInput
from adr_service.plugins import (
    METHODS,
    TASKS,
    OtherVersion,
    installed,
    load,
    origin,
    other_versions,
    package_of,
)
from tests.packages import add_entry_point


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


def test_a_package_keeps_the_version_that_it_had_when_it_was_imported(tmp_path, monkeypatch):
    add_entry_point(tmp_path, TASKS, "math:pi", "imported_once")
    monkeypatch.syspath_prepend(tmp_path)
    load(EntryPoint("imported_once", "math:pi", TASKS))
    about = tmp_path / "broken-1.0.dist-info/METADATA"
    about.write_text(about.read_text().replace("1.0", "1.1"))
    assert package_of(TASKS, "imported_once") == "broken 1.0"


@pytest.mark.parametrize(
    ("group", "member", "field"),
    [
        (TASKS, {"task": "of_two_versions"}, "package"),
        (METHODS, {"method": {"name": "of_two_versions"}}, "method_package"),
        (METHODS, {"curriculum": {"name": "of_two_versions"}}, "curriculum_package"),
    ],
)
def test_a_stage_of_another_version_names_both(tmp_path, monkeypatch, group, member, field):
    add_entry_point(tmp_path, group, "math:pi", "of_two_versions")
    monkeypatch.syspath_prepend(tmp_path)
    inputs = {"task": "arm", **member}
    others = other_versions({**inputs, field: "broken 0.9"})
    assert others == {field: OtherVersion("broken 0.9", "broken 1.0")}
    assert other_versions({**inputs, field: "broken 1.0"}) == {}


def test_a_stage_of_ours_or_of_a_package_that_is_gone_is_of_no_other_version():
    assert other_versions({"task": "arm"}) == {}
    assert other_versions({"task": "uninstalled", "package": "broken 0.9"}) == {}
